"""One IMU message of a vehicle: its readings are judged, and become samples in their place."""

import math
from collections import deque
from typing import Literal, NamedTuple

import numpy as np

from drivers.events import Event, Imu, Notice, Rejected, TrackLost, Value, VehicleId
from drivers.samples.sensor_faults import Readings, SensorFaults
from drivers.samples.vehicle_clock import REORDERED_US, Placed, TimeField
from estimator.compilation.compiled import compiled, inlined, types_of
from estimator.live.refusal import ACC_LIMIT_M_S2, RATE_LIMIT_RAD_S
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Bools, Floats, ImuSample, Times, Vec3

REPEAT_US = 240_000  # autopilots repeat a 10 Hz field; equal values in a 4 Hz stream are data
# Of those that may be a clock's that was set back so many wait for it to be sure.
MOST_HELD = 64


class Stamp(Value, frozen=True):
    """A message's time on one of the vehicle's clocks, and the arrival that its events carry."""

    clock: TimeField
    raw_us: int
    arrival_us: int


class Field(NamedTuple):
    """A magnetic field (gauss, FRD), zero where there is none.

    Readings of a magnetometer that is logged beside are numbered; 0 is too old.
    """

    gauss: Vec3
    number: int | None = None


class Reading(Value, frozen=True):
    """A message's vectors in SI units and gauss, without their place in time."""

    raw_us: int
    arrival_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    field: Field


class RepeatedField:
    """A slow magnetometer's field: fresh unless it repeats the last within 0.24 s.

    ``last`` is the last fresh field (gauss) and its time (us); it may be set.
    """

    def __init__(self) -> None:
        self.last: tuple[Vec3, int] = ZERO_VEC3, 0

    def is_fresh(self, mag_gauss: Vec3, time_us: int) -> bool:
        """Whether it is finite, not zero, and not repeated."""
        last, last_us = self.last
        if fresh := is_fresh(mag_gauss, time_us, last, last_us):
            self.last = mag_gauss, time_us
        return fresh

    def fresh_rows(self, mag_gauss: Floats, times_us: Times) -> Bools:
        """Which of N fields (N, 3) are: finite, not zero, and not repeated; (N,)."""
        fresh, last_gauss, last_us = fresh_of_rows(mag_gauss, times_us, *self.last)
        self.last = last_gauss, last_us
        return fresh


@inlined
def is_fresh(mag_gauss: Vec3, time_us: int, last: Vec3, last_us: int) -> bool:
    """Whether a field is finite, and neither zero nor a repetition of the last fresh one."""
    x, y, z = mag_gauss
    is_finite = math.isfinite(x) and math.isfinite(y) and math.isfinite(z)
    is_repeated = mag_gauss == last and 0 <= time_us - last_us < REPEAT_US
    return is_finite and mag_gauss != ZERO_VEC3 and not is_repeated


@compiled(types=lambda: types_of(np.zeros((1, 3)), np.zeros(1, np.int64), ZERO_VEC3, 0))
def fresh_of_rows(
    mag_gauss: Floats, times_us: Times, last: Vec3, last_us: int
) -> tuple[Bools, Vec3, int]:
    """:meth:`RepeatedField.is_fresh` of rows (N, 3) at times (N,); the last fresh one, its time."""
    fresh = np.zeros(len(times_us), np.bool_)
    for k in range(len(times_us)):
        field, time_us = (mag_gauss[k, 0], mag_gauss[k, 1], mag_gauss[k, 2]), times_us[k]
        if is_fresh(field, time_us, last, last_us):
            fresh[k], last, last_us = True, field, time_us
    return fresh, last, last_us


def finite_or_zero(vector: Vec3) -> Vec3:
    """The vector, or zero, which stands for none, if a part of it is not finite."""
    x, y, z = vector
    return vector if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else ZERO_VEC3


class ImuStream:
    """One IMU message of the vehicle: its faults, its slow field, and what waits for more."""

    def __init__(self, vehicle: VehicleId, name: str) -> None:
        self._vehicle, self._name = vehicle, name
        self._repetition, self._field_number = RepeatedField(), 0  # of the last that a sample had
        self._plausibility, self._faults = Plausibility(), SensorFaults()
        # Those that wait for the next ones to show whether the clock began anew or was set back
        self._held: list[Reading] = []
        self._held_for, self._held_since = Reason.CLOCK_STEP, 0

    def judge(self, stamp: Stamp, gyr: Vec3, acc: Vec3, field: Field) -> Reading | Reason:
        """The reading, or why it is no data."""
        raw_us, arrival_us = stamp.raw_us, stamp.arrival_us
        refusal = imu_refusal(gyr, acc)
        if refusal is not None:
            return refusal
        mag = self._faults.true_field(finite_or_zero(field.gauss), raw_us)
        readings = Readings(raw_us, gyr, acc, mag if is_field(mag) else ZERO_VEC3)
        refusal = self._faults.refusal(readings)
        if refusal is not None:
            return refusal
        if self._faults.stuck.mag.is_proven:
            mag = ZERO_VEC3
        field = field if mag is field.gauss else field._replace(gauss=mag)
        return Reading(raw_us, arrival_us, gyr, acc, field)

    def place(
        self,
        reading: Reading,
        placed: Placed,
        resets: list[Event],
        clock_resets: int,
        *,
        checks_axes: bool,
    ) -> list[Event]:
        """The events of a reading that the clock has placed, with the resets it has found.

        ``clock_resets`` counts the clock's, by any message.
        """
        # those that were held belong to a clock that began anew, as this or another stream shows
        since_us = REORDERED_US if clock_resets != self._held_since else 0
        since_us = since_us if placed.reset is None else placed.reset.since_us
        events, held, self._held = resets, self._held, []
        for each in held:
            ago_us = reading.raw_us - each.raw_us
            if 0 < ago_us <= since_us:
                at_us = placed.time_us - ago_us, placed.boot_us - ago_us
                events += self._samples(each, *at_us, checks_axes=checks_axes)
            else:
                events.append(self._rejected(each, self._held_for))
        if (blinded := self._faults.take_blindness()) is not None:
            events.append(TrackLost(self._vehicle, reading.arrival_us, self._name, *blinded))
        if self._faults.stuck.mag.is_proven:
            events.append(self._rejected(reading, Reason.MAGNETOMETER_STUCK))
        at_us = placed.time_us, placed.boot_us
        return events + self._samples(reading, *at_us, checks_axes=checks_axes)

    def end(self) -> list[Event]:
        """Nothing has come that explains those that were held: they are refused."""
        held, self._held = self._held, []
        return [self._rejected(each, self._held_for) for each in held]

    def arrival_us(self, reading: Reading) -> int:
        """When the first reading arrived that is placed with this one."""
        return self._held[0].arrival_us if self._held else reading.arrival_us

    def refuse(self, reading: Reading, reason: Reason, clock_resets: int) -> list[Event]:
        """The clock has not placed a reading: it waits for more to come, or is refused."""
        held = self._held
        goes_on = held and reading.raw_us > held[-1].raw_us
        is_more = goes_on and reason == self._held_for and len(held) < MOST_HELD
        events = [] if is_more else self.end()
        if reason not in (Reason.OUT_OF_ORDER, Reason.CLOCK_STEP):
            return [*events, self._rejected(reading, reason)]
        self._held_for, self._held_since = reason, clock_resets
        self._held.append(reading)
        return events

    def _samples(
        self, reading: Reading, time_us: int, boot_us: int, *, checks_axes: bool
    ) -> list[Event]:
        """The sample, with the magnetic field if that is new, and complaints about it."""
        fresh = reading.field.gauss if self._is_fresh(reading.field, time_us) else None
        has_mag = fresh is not None and is_field(fresh)
        mag = fresh if fresh is not None and has_mag else ZERO_VEC3
        sample = ImuSample._make((time_us, reading.gyr_rad_s, reading.acc_m_s2, mag, has_mag))
        arrival_us, name = reading.arrival_us, self._name
        events: list[Event] = [Imu(self._vehicle, arrival_us, boot_us, name, sample)]
        if fresh is not None and not has_mag:
            events.append(self._rejected(reading, Reason.MAGNETOMETER_OUT_OF_RANGE))
        for text in self._plausibility.look(sample, fresh, checks_axes=checks_axes):
            section: Literal["", "mounting"] = "mounting" if text == AXES_COMPLAINT else ""
            events.append(Notice(self._vehicle, arrival_us, f"{name}: {text}", section))
        return events

    def _is_fresh(self, field: Field, time_us: int) -> bool:
        """Whether a sample is to have the field."""
        if field.number is None:
            return self._repetition.is_fresh(field.gauss, time_us)
        if field.gauss == ZERO_VEC3 or field.number in (0, self._field_number):
            return False
        self._field_number = field.number
        return True

    def _rejected(self, reading: Reading, reason: Reason) -> Rejected:
        return Rejected(self._vehicle, reading.arrival_us, reason, self._name)


MAG_LIMIT_GAUSS = 8.0  # ten times the Earth's field and more; common magnetometers end there
# Latitude and longitude (degrees), and altitude (m) from the deepest sea to space
PLACES = (-90.0, 90.0), (-180.0, 180.0), (-12_000.0, 1_000_000.0)

SPACING_US = 200_000  # a window must outlast a flip or a fall, at any rate
WINDOW_SAMPLES = 50  # magnitudes are judged by their median over this many
FIRST_LOOK_SAMPLES, LEAST_SAMPLES = 20, 5
UNIT_LIMIT_GAUSS = 1e6  # no field in another unit, but a number that stands for none

AXES_COMPLAINT = (
    "accelerometer z is positive: upside down, or axes other than FRD. If it stands level, write "
    "into the profile: [mounting] acc_sign = -1 (or rotation_deg = [180, 0, 0] if y and z of the "
    "gyroscope are the other way round, too)"
)

WRONG_UNIT = "wrong unit or scale?"
# Where a median usually is, and what to report of another
USUAL: dict[str, tuple[float, float, str]] = {
    "force": (0.5, 2.0, f"accelerometer reads {{:.3g}} g, expected about 1 g: {WRONG_UNIT}"),
    # z, which is about -1 g where axes are FRD
    "axes": (-math.inf, 0.5, AXES_COMPLAINT),
    # the range of common MEMS gyroscopes
    "rate": (0.0, 2000.0, f"gyroscope reads {{:.3g}} deg/s: {WRONG_UNIT}"),
    # the Earth's is 0.25 to 0.65; scale and hard iron are often off
    "field": (0.05, 5.0, f"magnetometer reads {{:.3g}} gauss, expected about 0.5: {WRONG_UNIT}"),
}


def imu_refusal(gyr_rad_s: Vec3, acc_m_s2: Vec3) -> Reason | None:
    """Why a reading is no data whatever came before it; None if it is."""
    is_rate, is_force = _is_below(gyr_rad_s, RATE_LIMIT_RAD_S), _is_below(acc_m_s2, ACC_LIMIT_M_S2)
    if is_rate and is_force:
        return Reason.ZERO_ACCELEROMETER if acc_m_s2 == ZERO_VEC3 else None
    if not all(map(math.isfinite, gyr_rad_s + acc_m_s2)):
        return Reason.NOT_FINITE
    return Reason.ACCELEROMETER_OUT_OF_RANGE if is_rate else Reason.GYROSCOPE_OUT_OF_RANGE


def is_field(mag_gauss: Vec3) -> bool:
    """Whether a finite reading can be one of a magnetometer."""
    return _is_below(mag_gauss, MAG_LIMIT_GAUSS)


def is_place(position: Vec3) -> bool:
    """Whether latitude and longitude (degrees) and altitude (m) are those of a place."""
    return all(low <= value <= high for value, (low, high) in zip(position, PLACES, strict=True))


def _is_below(vector: Vec3, most: float) -> bool:
    x, y, z = vector
    return -most <= x <= most and -most <= y <= most and -most <= z <= most


class Plausibility:
    """Reports once, in words, that an IMU's magnitudes cannot be right."""

    def __init__(self) -> None:
        # the latest of each, of which the median counts
        self._latest = {name: deque[float](maxlen=WINDOW_SAMPLES) for name in USUAL}
        self._seen = 0
        self._next_us = 0  # when to look next
        self._reported: set[str] = set()

    def look(self, sample: ImuSample, field: Vec3 | None, *, checks_axes: bool) -> list[str]:
        """New complaints about the stream, each given once; usually none.

        ``field`` is the new magnetic field beside the sample, used or refused. ``checks_axes``:
        the sender is not known for sending FRD.
        """
        if 0 <= self._next_us - sample.time_us <= SPACING_US:
            return []
        self._next_us = sample.time_us + SPACING_US
        latest, acc = self._latest, sample.acc_m_s2
        latest["force"].append(math.hypot(*acc) / STANDARD_GRAVITY_M_S2)
        latest["axes"].append(acc[2] / STANDARD_GRAVITY_M_S2)
        latest["rate"].append(math.degrees(math.hypot(*sample.gyr_rad_s)))
        if field is not None and _is_below(field, UNIT_LIMIT_GAUSS):
            latest["field"].append(math.hypot(*field))
        self._seen += 1
        if self._seen % WINDOW_SAMPLES != 0 and self._seen != FIRST_LOOK_SAMPLES:
            return []
        new: list[str] = []
        for name, (low, high, complaint) in USUAL.items():
            values = sorted(latest[name])
            is_judged = len(values) >= LEAST_SAMPLES and (checks_axes or name != "axes")
            if is_judged and not low <= (median := values[len(values) // 2]) < high:
                new += [] if name in self._reported else [complaint.format(median)]
                self._reported.add(name)
        return new
