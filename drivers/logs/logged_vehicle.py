"""A vehicle as its own log saw it: what DataFlash, ULog, bags and tables have in common.

Most such logs know no arrivals. Their own times, on Unix time where a GPS gave it, stand in for
them.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from drivers.events import Event, Malformed, Rejected, VehicleId
from drivers.mavlink.gate import Repeats
from drivers.samples.imu_stream import Field, RepeatedField, Stamp, finite_or_zero
from drivers.samples.intake import Intake
from drivers.samples.navigation import Fix, Source, quaternion_from_euler, unit_or_none
from drivers.samples.vehicle_clock import BOOT_US, REORDERED_US, TimeField
from estimator.geometry.frames import swap_ned_enu
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, Vec3

R = TypeVar("R")

UNREADABLE = LookupError, TypeError, ValueError, OverflowError  # of rows
ONE_VEHICLE = VehicleId(1, 1)  # of a log that does not name it
RECEIVER = "GPS"  # the same of its satellite receiver
LONGEST_HOLE_US = 600 * 1_000_000  # a longer hole in a log is taken for a leap of its clock
FIRST_DATE_US = 946_684_800_000_000  # the year 2000: smaller times count from somewhere else
STALE_US = 200_000  # an older field that was logged beside no longer belongs to the sample after it


class LoggedVehicle:
    """Takes one vehicle's readings, each with the time that :meth:`at` was given last.

    ``unix_us`` is Unix time minus the log's time. Where a log's times count from its first row,
    ``begin_us`` is that row's, on Unix time unless it is too small for a date: then the clock is a
    computer's. Readings may be numbers of any kind, as the log has them. ``checks_axes`` is set
    where the axes may be others than FRD, ``has_arrivals`` where the log has arrivals, which
    distinguish a gap from a leap of the clock.

    Raises:
        TypeError, ValueError: what should be a number is none.
    """

    def __init__(
        self,
        vehicle: VehicleId = ONE_VEHICLE,
        unix_us: int = 0,
        *,
        begin_us: int = 0,
        checks_axes: bool = False,
        has_arrivals: bool = False,
    ) -> None:
        self.id = vehicle
        self.uses_first_filter = True  # of several that the log shows of
        self._counts_from_boot = begin_us <= FIRST_DATE_US
        self._unix_us = unix_us if self._counts_from_boot else begin_us
        self._begin_us = begin_us
        self._stamp = Stamp(TimeField.TIME_USEC, 0, self._unix_us)
        self._log_us: tuple[int | None, int] = None, 0  # the latest time, and its arrival
        log_time = None if has_arrivals else self._log_arrival_us
        self.intake = Intake(vehicle, log_time, counts_from_boot=self._counts_from_boot)
        self.intake.checks_axes = checks_axes
        self._mag_gauss = ZERO_VEC3  # the latest reading, zero where that was no number
        self._mag_us, self._mag_number = 0, 0  # of the latest one that is data
        self._repetition = RepeatedField()
        self._repeats, self._last_us = Repeats(), dict[str, int]()  # of IMU rows

    def at(
        self, raw_us: int, clock: TimeField = TimeField.TIME_USEC, arrival_us: int | None = None
    ) -> None:
        """What follows is of that time on the log's clock; without an arrival it stands in."""
        raw_us -= self._begin_us
        arrival_us = self._unix_us + raw_us if arrival_us is None else arrival_us
        self._stamp = Stamp(clock, raw_us, arrival_us)

    @property
    def arrival_us(self) -> int:
        """The time of arrival that events have now."""
        return self._stamp.arrival_us

    def events(
        self, rows: Iterable[R | None], of_row: Callable[["LoggedVehicle", R], Iterable[Event]]
    ) -> Iterator[Event]:
        """The events of rows, and of the end behind them.

        What cannot be read is counted: None, a row with other columns, or with garbage in one.
        """
        for row in rows:
            try:
                yield from [self.malformed()] if row is None else of_row(self, row)
            except UNREADABLE:
                yield self.malformed()
        yield from self.intake.end()

    def malformed(self) -> Event:
        """Something that cannot be read."""
        return Malformed(self.arrival_us, 1)

    def filter_status(
        self, flags: int, velocity_ratio: float, compass_ratio: float = 0.0
    ) -> list[Event]:
        """How well its own filter knows velocity and heading."""
        ratios = float(velocity_ratio), float(compass_ratio)
        return self.intake.filter_status(self.arrival_us, int(flags), *ratios)

    def put_mag(self, mag_gauss: Vec3) -> list[Event]:
        """Take a magnetic reading in, for the IMU samples behind it: each stream has it once."""
        raw_us = self._stamp.raw_us
        self._mag_gauss = finite_or_zero(_floats(mag_gauss))
        if self._repetition.is_fresh(self._mag_gauss, raw_us):
            self._mag_us, self._mag_number = raw_us, self._mag_number + 1
        return []

    def imu(self, stream: str, gyr_rad_s: Vec3, acc_m_s2: Vec3) -> list[Event]:
        """The sample, with the magnetic field if that is new; or why it is none."""
        raw_us, gyr, acc = self._stamp.raw_us, _floats(gyr_rad_s), _floats(acc_m_s2)
        has_come = self._repeats.before(hash((stream, raw_us, gyr, acc)), raw_us) is not None
        if self._counts_from_boot and raw_us <= BOOT_US:  # it may have started again
            has_come = False
        if has_come and 0 < self._last_us.get(stream, raw_us) - raw_us <= REORDERED_US:
            return [Rejected(self.id, self.arrival_us, Reason.DUPLICATE, stream)]
        self._last_us[stream] = raw_us
        field = Field(
            self._mag_gauss, 0 if abs(raw_us - self._mag_us) > STALE_US else self._mag_number
        )
        return self.intake.imu(stream, self._stamp, gyr, acc, field)

    def attitude(
        self, name: str, source: Source, numbers: Sequence[float], *, is_enu_flu: bool = False
    ) -> list[Event]:
        """Somebody's: a quaternion, w first, which may be none, or roll, pitch and yaw (rad).

        It is from NED to FRD, or from ENU to FLU.
        """
        if len(numbers) == 4:
            w, x, y, z = map(float, numbers)
            q = unit_or_none((w, x, y, z))
        else:
            q = quaternion_from_euler(*numbers)
        if is_enu_flu and q is not None:
            q = swap_ned_enu(q)
        return self.intake.attitude(name, self._stamp, source, q)

    def fix(self, name: str, fix: Fix) -> list[Event]:
        """A velocity and perhaps a position."""
        velocity, sigma_m_s, position = fix.velocity_ned_m_s, fix.sigma_m_s, fix.position
        of_floats = fix._replace(
            velocity_ned_m_s=None if velocity is None else _floats(velocity),
            sigma_m_s=None if sigma_m_s is None else float(sigma_m_s),
            position=None if position is None else _floats(position),
        )
        return self.intake.fix(name, self._stamp, of_floats)

    def _log_arrival_us(self, raw_us: int) -> int:
        """What stands in for the arrival: the log's own time, but no step beyond a hole's length.

        With the log's times as they are, a garbled one would pass for a gap of years.
        """
        last_us, arrival_us = self._log_us
        if last_us is not None:
            arrival_us += min(max(raw_us - last_us, 0), LONGEST_HOLE_US)
        self._log_us = raw_us, arrival_us
        return arrival_us


def _floats(vector: Vec3) -> Vec3:
    x, y, z = vector
    return (float(x), float(y), float(z))
