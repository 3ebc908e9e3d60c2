"""One vehicle's readings, judged and placed in time, for links and for logs.

What is no data is refused with a word to count it under. What is gets its place on the
vehicle's continuous clock and becomes events.
"""

import math
from collections.abc import Callable
from typing import Any

from drivers.events import (
    BodyRates,
    ClockReset,
    Event,
    Position,
    ReferenceAttitude,
    Rejected,
    Report,
    VehicleId,
    Velocity,
)
from drivers.samples.imu_stream import Field, ImuStream, Stamp, is_place
from drivers.samples.navigation import (
    Fix,
    Navigation,
    Source,
    UnstampedAttitudes,
    is_receiver,
    velocity_sample,
)
from drivers.samples.vehicle_clock import Placed, Reset, VehicleClock
from estimator.reasons import Reason
from estimator.types import Quaternion, RateSample, Vec3

MOST_STREAMS = 16  # IMUs of one vehicle; real ones have three, and four messages for them
# Where nobody shows attitudes of others, so many are enough to compare ours with.
ATTITUDE_EVERY_US = 390_000


class Intake:
    """Takes one vehicle's readings; each method gives the events that come of them.

    ``log_time`` is what stands in for the arrivals of a log that has none; ``counts_from_boot`` as
    in :class:`VehicleClock`. ``checks_axes`` is set where the axes may be others than FRD,
    ``takes_references`` where all attitudes of others are wanted, and not some a second.
    """

    def __init__(
        self,
        vehicle: VehicleId,
        log_time: Callable[[int], int] | None = None,
        *,
        counts_from_boot: bool = True,
    ) -> None:
        self.vehicle = vehicle
        self.checks_axes = False
        self.takes_references = True
        self._attitude_us = 0  # when the last one that was wanted arrived
        self._has_attitude = False  # of the autopilot's, with a time of its own
        self._log_time = log_time
        self.navigation = Navigation()
        self.clock = VehicleClock(has_arrivals=log_time is None, count_from_boot=counts_from_boot)
        self._imus: dict[str, ImuStream] = {}
        self._unstamped = UnstampedAttitudes(vehicle)

    @property
    def has_imu(self) -> bool:
        """Whether there was an IMU reading, good or bad."""
        return bool(self._imus)

    def imu(self, name: str, stamp: Stamp, gyr: Vec3, acc: Vec3, field: Field) -> list[Event]:
        """A reading of the IMU stream ``name``: rad/s, m/s^2 and the field, FRD."""
        stream = self._imus.get(name)
        if stream is None:
            if len(self._imus) >= MOST_STREAMS:
                return [Rejected(self.vehicle, stamp.arrival_us, Reason.TOO_MANY_STREAMS, name)]
            stream = self._imus[name] = ImuStream(self.vehicle, name)
        reading = stream.judge(stamp, gyr, acc, field)
        if isinstance(reading, Reason):
            return [Rejected(self.vehicle, stamp.arrival_us, reading, name)]
        placed, clock_resets = self._placed(name, stamp, is_imu=True), self.clock.resets
        if isinstance(placed, Reason):
            return stream.refuse(reading, placed, clock_resets)
        resets = self._resets(placed.reset, stream.arrival_us(reading))
        events = stream.place(reading, placed, resets, clock_resets, checks_axes=self.checks_axes)
        return events + self._unstamped.imu(placed.time_us, stamp.arrival_us)

    def end(self) -> list[Event]:
        """Nothing comes any more: what has waited for more to come."""
        held = [event for stream in self._imus.values() for event in stream.end()]
        return held + self._unstamped.end()

    def attitude(
        self,
        name: str,
        stamp: Stamp,
        source: Source,
        q_ned_frd: Quaternion | None,
        rate_rad_s: Vec3 | None = None,
    ) -> list[Event]:
        """Somebody's attitude, None for one that is no rotation, with the body rates beside it."""
        time_us, events = (None, []) if q_ned_frd is None else self._place(name, stamp)
        if time_us is None or q_ned_frd is None:
            return []
        about = self.vehicle, stamp.arrival_us
        events.append(ReferenceAttitude(*about, time_us, source, name, q_ned_frd))
        if rate_rad_s is not None:
            events.append(BodyRates(*about, name, RateSample(time_us, rate_rad_s)))
        return events

    def wants_attitude(self, arrival_us: int) -> bool:
        """Whether an attitude that arrives now is wanted; if so it counts as given."""
        self._has_attitude = True
        if self.takes_references:
            return True
        if 0 <= arrival_us - self._attitude_us < ATTITUDE_EVERY_US:
            return False
        self._attitude_us = arrival_us
        return True

    def report(
        self,
        name: str,
        stamp: Stamp,
        sample_at: Callable[[int], Any],
        kind: type[Report] = Report,
    ) -> list[Event]:
        """What something beside the IMU has measured.

        ``sample_at`` makes the sample of its time (us) on the vehicle's continuous clock.
        """
        time_us, events = self._place(name, stamp)
        if time_us is not None:
            events.append(kind(self.vehicle, stamp.arrival_us, name, sample_at(time_us)))
        return events

    def unstamped(
        self, name: str, arrival_us: int, source: Source, q_ned_frd: Quaternion | None
    ) -> list[Event]:
        """An attitude without a time of its own: it gets that of its IMU message.

        An autopilot's is left out if it sends attitudes that have a time.
        """
        if q_ned_frd is None or (source == "autopilot" and self._has_attitude):
            return []
        return self._unstamped.attitude(name, arrival_us, source, q_ned_frd)

    def filter_status(
        self, arrival_us: int, flags: int, velocity_ratio: float, compass_ratio: float
    ) -> list[Event]:
        """The status of the vehicle's own filter."""
        ratios = velocity_ratio, compass_ratio
        return [self.navigation.update_status(self.vehicle, arrival_us, flags, *ratios)]

    def fix(self, name: str, stamp: Stamp, fix: Fix) -> list[Event]:
        """A position and a velocity; each is left out where it is not finite.

        An autopilot's filter is believed as far as its status goes.
        """
        time_us, events = self._place(name, stamp) if fix.is_solved else (None, [])
        if time_us is None:
            return []
        arrival_us = stamp.arrival_us
        place, velocity = fix.position, velocity_sample(name, fix, time_us)
        if place is not None and all(map(math.isfinite, place)):
            if not is_place(place):
                events.append(Rejected(self.vehicle, arrival_us, Reason.POSITION_OUT_OF_RANGE))
            elif is_receiver(name) or self.navigation.accepts_position(*place[:2], arrival_us):
                events.append(Position(self.vehicle, arrival_us, time_us, name, *place))
        if velocity is not None:
            sigma_m_s: float | None = velocity.sigma_m_s
            if not is_receiver(name):
                sigma_m_s = self.navigation.velocity_sigma_m_s(velocity.sigma_m_s, arrival_us)
            if sigma_m_s is not None:
                velocity = velocity._replace(sigma_m_s=sigma_m_s)
                events.append(Velocity(self.vehicle, arrival_us, name, velocity))
        return events

    def _placed(self, name: str, stamp: Stamp, *, is_imu: bool = False) -> Placed | Reason:
        arrival_us = stamp.arrival_us
        if self._log_time is not None:
            arrival_us = self._log_time(stamp.raw_us)
        return self.clock.place(name, stamp.clock, stamp.raw_us, arrival_us, is_imu=is_imu)

    def _place(self, name: str, stamp: Stamp) -> tuple[int | None, list[Event]]:
        """The time of a message beside the IMU's, None without one, and the resets it shows."""
        placed = self._placed(name, stamp)
        if isinstance(placed, Reason):
            return None, []
        return placed.time_us, self._resets(placed.reset, stamp.arrival_us)

    def _resets(self, reset: Reset | None, arrival_us: int) -> list[Event]:
        if reset is None:
            return []
        if reset.reason == "reboot":
            self.navigation.forget()
        step_s, goes_on = reset.step_us * 1e-6, reset.elapsed_us is not None
        return [ClockReset(self.vehicle, arrival_us, reset.reason, step_s, goes_on)]
