"""Moments of a flight that a person knows it by: modes, arming, the autopilot's warnings."""

from drivers.events import Heartbeat, ModeChange, StatusText
from drivers.mavlink.constants import MAV_AUTOPILOT_PX4

LEAST_SEVERITY = 4  # MAV_SEVERITY_WARNING; greater numbers are less severe
MOST_TEXTS = 20  # a failing autopilot repeats itself
LETTERS = 32  # of a text that are shown

Moment = tuple[int, str]  # by the log's own stamps (us), and its name


class Marks:
    """Collects the moments of one vehicle; a mode or a text that is repeated counts once."""

    def __init__(self) -> None:
        self._arming: list[tuple[int, int]] = []  # arrival, and whether it is armed since
        self._modes: list[tuple[int, int]] = []  # arrival and number
        self._texts: dict[str, int] = {}  # when it first came

    def take(self, event: Heartbeat | ModeChange | StatusText) -> None:
        """Note what is new in an event."""
        if isinstance(event, StatusText):
            if event.severity <= LEAST_SEVERITY and len(self._texts) < MOST_TEXTS:
                self._texts.setdefault(event.text, event.arrival_us)
            return
        for known, value in ((self._arming, event.is_armed), (self._modes, event.custom_mode)):
            if value is not None and (not known or known[-1][1] != value):
                known.append((event.arrival_us, value))

    def found(self, begin_us: int, autopilot: int | None, vehicle_type: int | None) -> list[Moment]:
        """All from a moment on, in the order of time; first the mode that the vehicle was in.

        The numbers of modes have their names from MAV_AUTOPILOT and MAV_TYPE.
        """
        names = self._mode_names(autopilot, vehicle_type)
        modes = [(us, names.get(number, f"mode {number}")) for us, number in self._modes]
        others = [(us, "armed" if armed else "disarmed") for us, armed in self._arming[1:]]
        others += [(us, text[:LETTERS]) for text, us in self._texts.items()]
        began = [(begin_us, name) for us, name in modes if us < begin_us][-1:]
        return began + sorted(each for each in modes + others if each[0] >= begin_us)

    def _mode_names(self, autopilot: int | None, vehicle_type: int | None) -> dict[int, str]:
        """The names of the modes, from pymavlink's tables."""
        if not self._modes:
            return {}
        from pymavlink import mavutil

        if autopilot == MAV_AUTOPILOT_PX4:
            return {n: mavutil.interpret_px4_mode(1, n) for _, n in self._modes}
        return mavutil.mode_mapping_bynumber(vehicle_type) or {}
