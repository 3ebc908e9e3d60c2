"""A vehicle as its own log saw it: what DataFlash, ULog, bags and tables have in common.

Such a log knows no arrivals. Its own times, on Unix time where a GPS gave it, stand in for them.
"""

from collections.abc import Callable
from typing import Any, Literal

from drivers.events import Event, FilterStatus, VehicleId
from drivers.samples.fresh_field import LoggedField
from drivers.samples.imu_stream import Stamp
from drivers.samples.intake import Intake
from drivers.samples.navigation import Fix, Navigation
from drivers.samples.vehicle_clock import TimeField
from estimator.types import Quaternion, Vec3

LONGEST_HOLE_US = 600 * 1_000_000  # a longer hole in a log is taken for a leap of its clock


class LogTime:
    """What stands in for arrival times: the log's own times, but no step beyond a hole's length.

    With the log's times as they are, a garbled one would pass for a gap of
    years. The result is not meant to be published.
    """

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._arrival_us = 0

    def arrival_us(self, raw_us: int) -> int:
        """The stand-in for the arrival of a message stamped ``raw_us``."""
        if self._last_us is not None:
            self._arrival_us += min(max(raw_us - self._last_us, 0), LONGEST_HOLE_US)
        self._last_us = raw_us
        return self._arrival_us


class LoggedVehicle:
    """Gives one vehicle's readings their stamps. ``unix_us`` is Unix time minus the log's time.

    Readings may be numbers of any kind, as the log has them. ``doubts_axes`` says that its axes
    may be others than FRD.

    Raises:
        TypeError, ValueError: what should be a number is none.
    """

    def __init__(self, vehicle: VehicleId, unix_us: int, *, doubts_axes: bool = False) -> None:
        self.id = vehicle
        self._unix_us = unix_us
        log_time = LogTime()
        self._field = LoggedField()
        self._intake = Intake(vehicle, self._field.for_stream, log_time.arrival_us)
        self._intake.doubts_axes = doubts_axes

    @property
    def navigation(self) -> Navigation:
        """How far its filter is believed."""
        return self._intake.navigation

    def filter_says(self, status: FilterStatus, raw_us: int) -> list[Event]:
        """What its filter says of itself."""
        return self._intake.filter_says(status, self.arrival_us(raw_us))

    def arrival_us(self, raw_us: int) -> int:
        """The log's time ``raw_us`` as a time of arrival."""
        return self._unix_us + raw_us

    def put_mag(self, mag_gauss: Vec3, raw_us: int) -> None:
        """Take a magnetic reading in, for the IMU samples behind it."""
        self._field.put(_floats(mag_gauss), raw_us)

    def imu(
        self, stream: str, clock: TimeField, raw_us: int, gyr_rad_s: Vec3, acc_m_s2: Vec3
    ) -> list[Event]:
        """The sample, with the magnetic field if that is new; or why it is none."""
        gyr, acc, stamp = _floats(gyr_rad_s), _floats(acc_m_s2), self._stamp(clock, raw_us)
        return self._intake.imu(stream, stamp, gyr, acc, self._field.latest_gauss)

    def attitude(
        self,
        name: str,
        clock: TimeField,
        raw_us: int,
        source: Literal["autopilot", "sim"],
        q_ned_frd: Quaternion | None,
    ) -> list[Event]:
        """Somebody's attitude; None for one that is no rotation."""
        return self._intake.attitude(name, self._stamp(clock, raw_us), source, q_ned_frd)

    def fix(self, name: str, clock: TimeField, raw_us: int, fix: Fix) -> list[Event]:
        """A velocity and perhaps a position."""
        velocity, sigma_m_s, position = fix.velocity_ned_m_s, fix.sigma_m_s, fix.position
        of_floats = fix._replace(
            velocity_ned_m_s=None if velocity is None else _floats(velocity),
            sigma_m_s=None if sigma_m_s is None else float(sigma_m_s),
            position=None if position is None else _floats(position),
        )
        return self._intake.fix(name, self._stamp(clock, raw_us), of_floats)

    def report(
        self, name: str, clock: TimeField, raw_us: int, sample_at: Callable[[int], Any]
    ) -> list[Event]:
        """What something beside the IMU has measured; see :meth:`Intake.report`."""
        return self._intake.report(name, self._stamp(clock, raw_us), sample_at)

    def _stamp(self, clock: TimeField, raw_us: int) -> Stamp:
        return Stamp(clock, raw_us, self.arrival_us(raw_us))


def _floats(vector: Vec3) -> Vec3:
    x, y, z = vector
    return (float(x), float(y), float(z))
