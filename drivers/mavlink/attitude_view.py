"""Of what the autopilot shows the attitude: its IMU's, the vehicle's, or a view for its pilot.

ArduPilot trims the IMU in the vehicle. A plane shows its pitch less the one that it cruises with,
and a tailsitter shows a copter while it hovers: the same attitude, seen along another axis.
"""

from math import isfinite, pi, radians

from drivers.mavlink.ardupilot import TRIM
from drivers.samples.navigation import quaternion_from_euler
from estimator.geometry.frames import euler_rad, from_euler_rad
from estimator.geometry.quaternion import multiply
from estimator.types import IDENTITY, Quaternion

PITCH_TRIMS = {"PTCH_TRIM_DEG": radians(1.0), "TRIM_PITCH_CD": radians(0.01)}  # since 4.5, before
FLIGHT_OPTIONS, SHOWS_ALL = "FLIGHT_OPTIONS", 1 << 8  # the pitch is shown with that trim
IS_QUADPLANE, IS_TAILSITTER = "Q_ENABLE", "Q_TAILSIT_ENABLE"
NAMES = frozenset({*TRIM, *PITCH_TRIMS, FLIGHT_OPTIONS, IS_QUADPLANE, IS_TAILSITTER})
TAILSITTERS, VTOLS = frozenset((19, 20, 23)), frozenset(range(19, 26))  # MAV_TYPE
UPRIGHT = from_euler_rad(0.0, 0.5 * pi, 0.0)
TRIMMED_MESSAGE = "ATTITUDE"  # no other one leaves the pitch's trim out


class AttitudeView:
    """What parameters and HEARTBEAT show of it; ``vehicle_type`` is a MAV_TYPE."""

    def __init__(self) -> None:
        self.vehicle_type: int | None = None
        self._values: dict[str, float] = {}

    def take(self, name: str, value: float) -> None:
        """Note one of the parameters in :data:`NAMES`."""
        if isfinite(value):
            self._values[name] = value

    @property
    def is_imus(self) -> bool:
        """Whether what is shown is the IMU's attitude in any case."""
        return not any(self._values.values()) and self.vehicle_type not in VTOLS

    @property
    def trim(self) -> Quaternion:
        """From the vehicle's axes to those of its IMU."""
        roll, pitch, yaw = (self._values.get(name, 0.0) for name in TRIM)
        return quaternion_from_euler(roll, pitch, yaw) or IDENTITY

    def of_imu(self, message: str, shown: Quaternion, ours: Quaternion) -> Quaternion | None:
        """The attitude of the IMU that ``message`` shows; None if it is not known.

        Which view a vehicle shows that can hover depends on what it does: it is the one that is
        nearest to ``ours``.
        """
        trim = self.trim
        views = [multiply(view, trim) for view in self._views(message, shown)]
        nearest = max(views, key=lambda view: abs(sum(map(float.__mul__, view, ours))))
        is_sure = self._is_tailsitter is not None or nearest is not views[-1]
        return nearest if is_sure or len(views) == 1 else None

    @property
    def _is_tailsitter(self) -> bool | None:
        """None where neither a parameter nor the type shows."""
        parameter = self._values.get(IS_TAILSITTER)
        if parameter is not None:
            return parameter > 0.0 or self.vehicle_type in TAILSITTERS
        if self.vehicle_type in TAILSITTERS:
            return True
        return None if self.vehicle_type in VTOLS else False

    def _views(self, message: str, shown: Quaternion) -> list[Quaternion]:
        """What may be shown; a tailsitter's comes last."""
        if message != TRIMMED_MESSAGE:
            return [shown]
        trim_rad = sum(unit * self._values.get(name, 0.0) for name, unit in PITCH_TRIMS.items())
        if int(self._values.get(FLIGHT_OPTIONS, 0.0)) & SHOWS_ALL:
            trim_rad = 0.0
        views = [shown]
        if trim_rad:
            roll, pitch, yaw = euler_rad(shown)
            hovers = self._values.get(IS_QUADPLANE, 0.0) > 0.0 or self.vehicle_type in VTOLS
            views = [from_euler_rad(roll, pitch + trim_rad, yaw), *([shown] if hovers else [])]
        return views if self._is_tailsitter is False else [*views, multiply(shown, UPRIGHT)]
