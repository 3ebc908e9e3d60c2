"""One vehicle's readings, judged and placed in time, for links and for logs.

What is no data is refused with a word to count it under. What is gets its place on the
vehicle's continuous clock and becomes events.
"""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from drivers.events import (
    BodyRates,
    ClockReset,
    Event,
    FilterStatus,
    FilterWord,
    Imu,
    Notice,
    Position,
    ReferenceAttitude,
    Rejected,
    Report,
    TrackLost,
    VehicleId,
    Velocity,
)
from drivers.samples.fix import Fix, velocity_sample
from drivers.samples.fresh_field import FreshField, RepeatedField, finite_or_zero
from drivers.samples.navigation import Navigation
from drivers.samples.plausibility import AXES_COMPLAINT, Plausibility
from drivers.samples.preference import is_receiver
from drivers.samples.sensor_faults import Readings, SensorFaults
from drivers.samples.vehicle_clock import Placed, Refused, TimeField, VehicleClock
from drivers.value import Value
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, ImuSample, Quaternion, RateSample, Vec3, VelocitySample

MOST_STREAMS = 16  # IMUs of one vehicle; real ones have three, and four messages for them
CLOCK_STEP = Refused(Reason.CLOCK_STEP)
# Where nobody shows attitudes of others, so many are enough to compare ours with.
ATTITUDE_EVERY_US = 390_000
# What a vehicle is it may say often; once in a while is enough.
VERSION_EVERY_US = 900_000


class Stamp(NamedTuple):
    """A message's time on one of the vehicle's clocks, and the arrival that its events carry."""

    clock: TimeField
    raw_us: int
    arrival_us: int


class _Reading(Value, frozen=True):
    """A message's vectors in SI units and gauss, without their place in time."""

    raw_us: int
    arrival_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


class _ImuStream:
    """What is remembered about one IMU message of the vehicle."""

    def __init__(self, name: str, field: FreshField) -> None:
        self.name = name
        self.field = field
        self.plausibility = Plausibility()
        self.faults = SensorFaults()
        self.held: _Reading | None = None  # until the next one tells whether the clock began anew


class Intake:
    """Takes one vehicle's readings; each method gives the events that come of them.

    ``new_field`` makes what tells an IMU stream's fresh fields from the others. ``heard_us``
    is the arrival that tells a gap from a leap of the clock; a log that knows no arrivals has
    something else for it. ``doubts_axes`` says that the axes may be others than FRD,
    ``takes_references`` that all attitudes of others are wanted, and not some a second.
    """

    def __init__(
        self,
        vehicle: VehicleId,
        new_field: Callable[[], FreshField] = RepeatedField,
        heard_us: Callable[[Stamp], int] = lambda stamp: stamp.arrival_us,
    ) -> None:
        self.vehicle = vehicle
        self.doubts_axes = False
        self.takes_references = True
        self.heard_us = 0  # arrival of the latest message, whatever it was
        self.attitude_given_us = 0
        self.version_given_us = 0  # when it was looked into what vehicle it is
        self._has_attitude = False  # of the autopilot's, with a time of its own
        self._new_field = new_field
        self._heard_us = heard_us
        self.navigation = Navigation()
        self.clock = VehicleClock()
        self._imus: dict[str, _ImuStream] = {}
        self.last_imu_us: int | None = None  # of the latest IMU sample
        self._unstamped_us: dict[str, int] = {}  # the time that each has had last

    @property
    def has_imu(self) -> bool:
        """Whether there was an IMU reading, good or bad."""
        return bool(self._imus)

    def imu(self, name: str, stamp: Stamp, gyr: Vec3, acc: Vec3, mag: Vec3) -> list[Event]:
        """A reading of the IMU stream ``name``: rad/s, m/s^2 and gauss, FRD; no field is zero."""
        stream = self._stream(name)
        arrival_us, raw_us = stamp.arrival_us, stamp.raw_us
        if stream is None:
            return [Rejected(self.vehicle, arrival_us, Reason.TOO_MANY_STREAMS, name)]
        field, faults = finite_or_zero(mag), stream.faults
        refusal = _refusal(gyr, acc) or faults.refusal(Readings(gyr, acc, field), raw_us)
        if refusal is not None:
            return [Rejected(self.vehicle, arrival_us, refusal, name)]
        mag_is_stuck = faults.mag_is_stuck
        reading = _Reading(raw_us, arrival_us, gyr, acc, ZERO_VEC3 if mag_is_stuck else field)
        placed = self.clock.imu(name, stamp.clock, raw_us, self._heard_us(stamp))
        held, stream.held = stream.held, None
        if isinstance(placed, Refused):
            unconfirmed: list[Event] = [self._clock_step(held, name)] if held else []
            if placed == CLOCK_STEP:
                stream.held = reading
                return unconfirmed
            return [*unconfirmed, Rejected(self.vehicle, arrival_us, placed.reason, name)]
        events: list[Event] = []
        if held is not None or placed.reset is not None:
            events = self._settle_held(stream, held, placed, arrival_us)
        if (blindness := faults.take_blindness()) is not None:
            reason, span_us = blindness
            events.append(TrackLost(self.vehicle, arrival_us, name, reason, span_us * 1e-6))
        if mag_is_stuck:
            events.append(Rejected(self.vehicle, arrival_us, Reason.MAGNETOMETER_STUCK, name))
        return events + self._samples(stream, reading, placed.time_us, placed.boot_us)

    def attitude(
        self,
        name: str,
        stamp: Stamp,
        source: Literal["autopilot", "sim"],
        q_ned_frd: Quaternion | None,
        rate_rad_s: Vec3 | None = None,
    ) -> list[Event]:
        """Somebody's attitude, None for one that is no rotation, with the body rates beside it."""
        placed = None if q_ned_frd is None else self._place(name, stamp)
        if placed is None or q_ned_frd is None:
            return []
        vehicle, arrival_us, time_us = self.vehicle, stamp.arrival_us, placed.time_us
        events = self._resets(placed, arrival_us)
        events.append(ReferenceAttitude(vehicle, arrival_us, time_us, source, name, q_ned_frd))
        if rate_rad_s is not None:
            events.append(BodyRates(vehicle, arrival_us, name, RateSample(time_us, rate_rad_s)))
        return events

    def wants_attitude(self, arrival_us: int) -> bool:
        """Whether an attitude that arrives now is wanted; if so it counts as given."""
        self._has_attitude = True
        if self.takes_references:
            return True
        if 0 <= arrival_us - self.attitude_given_us < ATTITUDE_EVERY_US:
            return False
        self.attitude_given_us = arrival_us
        return True

    def rates(self, name: str, stamp: Stamp, rate_rad_s: Vec3) -> list[Event]:
        """Body rates beside somebody's attitude that nobody wants."""
        return self.report(name, stamp, lambda us: RateSample(us, rate_rad_s), BodyRates)

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
        placed = self._place(name, stamp)
        if placed is None:
            return []
        event = kind(self.vehicle, stamp.arrival_us, name, sample_at(placed.time_us))
        return [*self._resets(placed, stamp.arrival_us), event]

    def unstamped(
        self,
        name: str,
        arrival_us: int,
        source: Literal["autopilot", "sim"],
        q_ned_frd: Quaternion | None,
    ) -> list[Event]:
        """An attitude without a time of its own: it gets that of the IMU message before it.

        A second one behind the same IMU message is left out: its own IMU message was lost. So is
        an autopilot's, if it sends attitudes that have a time.
        """
        time_us = self.last_imu_us
        if q_ned_frd is None or time_us is None or self._unstamped_us.get(name) == time_us:
            return []
        if source == "autopilot" and self._has_attitude:
            return []
        self._unstamped_us[name] = time_us
        return [ReferenceAttitude(self.vehicle, arrival_us, time_us, source, name, q_ned_frd)]

    def filter_says(self, status: FilterStatus, arrival_us: int) -> list[Event]:
        """The vehicle's own filter speaks of itself."""
        self.navigation.hear_status(status, arrival_us)
        return [FilterWord(self.vehicle, arrival_us, status)]

    def fix(self, name: str, stamp: Stamp, fix: Fix) -> list[Event]:
        """A position and a velocity; each is left out where it is not finite.

        An autopilot's filter is believed as far as it believes itself.
        """
        placed = self._place(name, stamp) if fix.is_solved else None
        if placed is None:
            return []
        arrival_us, time_us = stamp.arrival_us, placed.time_us
        events = self._resets(placed, arrival_us)
        position = self._believed_position(name, fix.position, arrival_us)
        if position is not None:
            events.append(Position(self.vehicle, arrival_us, time_us, name, *position))
        velocity = self._believed_velocity(name, velocity_sample(name, fix, time_us), arrival_us)
        if velocity is not None:
            events.append(Velocity(self.vehicle, arrival_us, name, velocity))
        return events

    def _believed_position(self, name: str, position: Vec3 | None, arrival_us: int) -> Vec3 | None:
        if position is None or not all(map(math.isfinite, position)):
            return None
        latitude_deg, longitude_deg, _ = position
        is_believed = is_receiver(name) or self.navigation.believes_place(
            latitude_deg, longitude_deg, arrival_us
        )
        return position if is_believed else None

    def _believed_velocity(
        self, name: str, sample: VelocitySample | None, arrival_us: int
    ) -> VelocitySample | None:
        if sample is None or is_receiver(name):
            return sample
        sigma_m_s = self.navigation.velocity_sigma_m_s(sample.sigma_m_s, arrival_us)
        return None if sigma_m_s is None else sample._replace(sigma_m_s=sigma_m_s)

    def _stream(self, name: str) -> _ImuStream | None:
        """The stream of that name, a new one if need be; None if there are too many."""
        stream = self._imus.get(name)
        if stream is None and len(self._imus) < MOST_STREAMS:
            stream = self._imus[name] = _ImuStream(name, self._new_field())
        return stream

    def _settle_held(
        self, stream: _ImuStream, held: _Reading | None, placed: Placed, arrival_us: int
    ) -> list[Event]:
        """The clock's reset, and the sample that waited for it to be confirmed."""
        events = self._resets(placed, held.arrival_us if held else arrival_us)
        if held is None:
            return events
        if placed.reset is None:
            return [self._clock_step(held, stream.name)]
        before_us = placed.since_reset_us
        return events + self._samples(
            stream, held, placed.time_us - before_us, placed.boot_us - before_us
        )

    def _samples(
        self, stream: _ImuStream, reading: _Reading, time_us: int, boot_us: int
    ) -> list[Event]:
        """The sample, with the magnetic field if that is new, and complaints about it."""
        name, arrival_us = stream.name, reading.arrival_us
        self.last_imu_us = time_us
        fresh = stream.field.fresh(reading.mag_gauss, reading.raw_us, time_us)
        mag, has_mag = (ZERO_VEC3, False) if fresh is None else (fresh, True)
        sample = ImuSample._make((time_us, reading.gyr_rad_s, reading.acc_m_s2, mag, has_mag))
        events: list[Event] = [Imu(self.vehicle, arrival_us, boot_us, name, sample)]
        complaints = stream.plausibility.look(sample, doubts_axes=self.doubts_axes)
        return events + self._notices(name, arrival_us, complaints)

    def _notices(self, name: str, arrival_us: int, complaints: list[str]) -> list[Event]:
        notices: list[Event] = []
        for text in complaints:
            section: Literal["", "mounting"] = "mounting" if text == AXES_COMPLAINT else ""
            notices.append(Notice(self.vehicle, arrival_us, f"{name}: {text}", section))
        return notices

    def _place(self, name: str, stamp: Stamp) -> Placed | None:
        placed = self.clock.other(name, stamp.clock, stamp.raw_us, self._heard_us(stamp))
        return None if isinstance(placed, Refused) else placed

    def _resets(self, placed: Placed, arrival_us: int) -> list[Event]:
        reset = placed.reset
        if reset is None:
            return []
        if reset.reason == "reboot":
            self.navigation.forget()
        return [ClockReset(self.vehicle, arrival_us, reset.reason, reset.step_us * 1e-6)]

    def _clock_step(self, held: _Reading, name: str) -> Rejected:
        return Rejected(self.vehicle, held.arrival_us, CLOCK_STEP.reason, name)


def _refusal(gyr: Vec3, acc: Vec3) -> Reason | None:
    """Why a reading is no data whatever came before it; None if it is."""
    if not all(map(math.isfinite, gyr + acc)):
        return Reason.NOT_FINITE
    return Reason.ZERO_ACCELEROMETER if acc == ZERO_VEC3 else None
