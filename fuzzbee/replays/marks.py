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
        self._armed: bool | None = None
        self._mode: int | None = None
        self._modes: list[tuple[int, int]] = []  # arrival and number
        self._others: list[Moment] = []
        self._texts: set[str] = set()

    def take(self, event: Heartbeat | ModeChange | StatusText) -> None:
        """Note what is new in an event."""
        if isinstance(event, StatusText):
            self._note_text(event)
            return
        self._note_arming(event.arrival_us, event.is_armed)
        self._note_mode(event.arrival_us, event.custom_mode)

    def found(self, begin_us: int, autopilot: int | None, vehicle_type: int | None) -> list[Moment]:
        """All from a moment on, in the order of time; first the mode that the vehicle was in.

        The numbers of modes have their names from MAV_AUTOPILOT and MAV_TYPE.
        """
        names = self._mode_names(autopilot, vehicle_type)
        modes = [(us, names.get(number, f"mode {number}")) for us, number in self._modes]
        began = [(begin_us, name) for us, name in modes if us < begin_us][-1:]
        later = sorted(each for each in (*modes, *self._others) if each[0] >= begin_us)
        return [*began, *later]

    def _note_arming(self, arrival_us: int, is_armed: bool | None) -> None:
        if is_armed is None:
            return
        if self._armed not in (None, is_armed):
            self._others.append((arrival_us, "armed" if is_armed else "disarmed"))
        self._armed = is_armed

    def _note_mode(self, arrival_us: int, number: int | None) -> None:
        if number is not None and number != self._mode:
            self._mode = number
            self._modes.append((arrival_us, number))

    def _note_text(self, event: StatusText) -> None:
        is_new = event.text not in self._texts and len(self._texts) < MOST_TEXTS
        if event.severity <= LEAST_SEVERITY and is_new:
            self._texts.add(event.text)
            self._others.append((event.arrival_us, event.text[:LETTERS]))

    def _mode_names(self, autopilot: int | None, vehicle_type: int | None) -> dict[int, str]:
        """The names of the modes, from pymavlink's tables."""
        if not self._modes:
            return {}
        from pymavlink import mavutil

        if autopilot == MAV_AUTOPILOT_PX4:
            numbers = {number for _, number in self._modes}
            return {n: mavutil.interpret_px4_mode(1, n) for n in numbers}
        return mavutil.mode_mapping_bynumber(vehicle_type) or {}
