"""One IMU message of a vehicle: its readings are judged, and become samples in their place."""

from typing import Literal, NamedTuple

from drivers.events import Event, Imu, Notice, Rejected, TrackLost, VehicleId
from drivers.samples.fresh_field import FreshField, finite_or_zero
from drivers.samples.plausibility import AXES_COMPLAINT, Plausibility, imu_refusal, is_field
from drivers.samples.sensor_faults import SensorFaults
from drivers.samples.stuck import Readings
from drivers.samples.vehicle_clock import Placed, Refused, TimeField
from drivers.value import Value
from estimator.reasons import Reason
from estimator.types import ZERO_VEC3, ImuSample, Vec3


class Stamp(NamedTuple):
    """A message's time on one of the vehicle's clocks, and the arrival that its events carry."""

    clock: TimeField
    raw_us: int
    arrival_us: int


class Reading(Value, frozen=True):
    """A message's vectors in SI units and gauss, without their place in time."""

    raw_us: int
    arrival_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


class ImuStream:
    """What is remembered about one IMU message of the vehicle."""

    def __init__(self, vehicle: VehicleId, name: str, field: FreshField) -> None:
        self._vehicle, self._name = vehicle, name
        self._field = field
        self._plausibility = Plausibility()
        self._faults = SensorFaults()
        self._held: Reading | None = None  # until the next one tells whether the clock began anew

    def judge(self, stamp: Stamp, gyr: Vec3, acc: Vec3, mag: Vec3) -> Reading | Reason:
        """The reading, or why it is no data."""
        _, raw_us, arrival_us = stamp
        refusal = imu_refusal(gyr, acc)
        if refusal is not None:
            return refusal
        field = finite_or_zero(mag)
        readings = Readings(gyr, acc, field if is_field(field) else ZERO_VEC3)
        refusal = self._faults.refusal(readings, raw_us)
        if refusal is not None:
            return refusal
        if self._faults.mag_is_stuck:
            field = ZERO_VEC3
        return Reading(raw_us, arrival_us, gyr, acc, field)

    def place(
        self,
        reading: Reading,
        placed: Placed | Refused,
        resets: list[Event],
        *,
        doubts_axes: bool,
    ) -> list[Event]:
        """The events of a reading that the clock has placed, with the resets it has found."""
        held, self._held = self._held, None
        events: list[Event] = resets
        if isinstance(placed, Refused):
            events = [] if held is None else [self._rejected(held, Reason.CLOCK_STEP)]
            if placed.reason == Reason.CLOCK_STEP:
                self._held = reading
                return events
            return [*events, self._rejected(reading, placed.reason)]
        if held is not None and placed.reset is None:
            events.append(self._rejected(held, Reason.CLOCK_STEP))
        elif held is not None:
            ago_us = placed.since_reset_us
            at_us = placed.time_us - ago_us, placed.boot_us - ago_us
            events += self._samples(held, *at_us, doubts_axes=doubts_axes)
        if (blinded := self._faults.take_blindness()) is not None:
            lost = (blinded.reason, blinded.span_us * 1e-6)
            events.append(TrackLost(self._vehicle, reading.arrival_us, self._name, *lost))
        if self._faults.mag_is_stuck:
            events.append(self._rejected(reading, Reason.MAGNETOMETER_STUCK))
        return events + self._samples(
            reading, placed.time_us, placed.boot_us, doubts_axes=doubts_axes
        )

    def arrival_us(self, reading: Reading) -> int:
        """When the first reading arrived that is placed with this one."""
        return reading.arrival_us if self._held is None else self._held.arrival_us

    def _samples(
        self, reading: Reading, time_us: int, boot_us: int, *, doubts_axes: bool
    ) -> list[Event]:
        """The sample, with the magnetic field if that is new, and complaints about it."""
        fresh = self._field.fresh(reading.mag_gauss, reading.raw_us, time_us)
        has_mag = fresh is not None and is_field(fresh)
        mag = fresh if fresh is not None and has_mag else ZERO_VEC3
        sample = ImuSample._make((time_us, reading.gyr_rad_s, reading.acc_m_s2, mag, has_mag))
        arrival_us, name = reading.arrival_us, self._name
        events: list[Event] = [Imu(self._vehicle, arrival_us, boot_us, name, sample)]
        if fresh is not None and not has_mag:
            events.append(self._rejected(reading, Reason.MAGNETOMETER_OUT_OF_RANGE))
        for text in self._plausibility.look(sample, fresh, doubts_axes=doubts_axes):
            section: Literal["", "mounting"] = "mounting" if text == AXES_COMPLAINT else ""
            events.append(Notice(self._vehicle, arrival_us, f"{name}: {text}", section))
        return events

    def _rejected(self, reading: Reading, reason: Reason) -> Rejected:
        return Rejected(self._vehicle, reading.arrival_us, reason, self._name)
