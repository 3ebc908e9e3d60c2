"""Readings that look like data and are none: of sensors that are stuck, at their end, or leap."""

from dataclasses import dataclass, field

from drivers.samples.stuck import (
    MICROSECOND,
    NOISY_SAMPLES,
    NOTHING,
    Readings,
    StuckField,
    StuckImu,
    largest,
)
from estimator.geometry.quaternion import subtract
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2 as G
from estimator.types import ZERO_VEC3, Vec3

# While readings are refused for one of these the vehicle may turn unseen, and the first of them
# were believed, until the fault showed.
BLINDING = (
    *(Reason.STUCK, Reason.GYROSCOPE_STUCK),
    *(Reason.ACCELEROMETER_STUCK, Reason.GYROSCOPE_SATURATED),
)
BLIND_US = 30_000  # from the first refused reading on
RAIL_SAMPLES = 4  # equal large values
LONGEST_STEP_S = 0.05  # over a longer one a wrapped value and a fast change look alike
# No vehicle changes its rate faster.
RATE_STEP_RAD_S = 10.0
RATE_STEP_RAD_S2 = 500.0


@dataclass(slots=True)
class RangeEnd:
    """Follows one sensor's three axes.

    ``rail`` is where ranges begin to end: below it equal values are none. ``field_end`` is where
    the messages' 16-bit fields end, ``most`` what the sensor can read at all, and ``step`` with
    ``step_a_s`` what it can change by between two readings.
    """

    rail: float
    field_end: float
    most: float
    step: float
    step_a_s: float = 0.0
    last: Vec3 = ZERO_VEC3
    changes: list[int] = field(default_factory=lambda: [0, 0, 0])  # of each axis: it has noise
    equal: list[int] = field(default_factory=lambda: [0, 0, 0])  # readings at a rail in a row
    wraps: list[int] = field(default_factory=lambda: [0, 0, 0])  # over the field's end so far
    is_noisy: bool = False  # on all axes
    is_large: bool = False  # the latest reading, or not as small as it seems

    def is_reached(self, now: Vec3, step_s: float) -> bool:
        """Whether a reading, ``step_s`` after the last, is at an end or beyond."""
        x, y, z = now
        rail, last, self.last = self.rail, self.last, now
        if -rail < x < rail and -rail < y < rail and -rail < z < rail:
            if self.is_noisy and not self.is_large:  # nearly always
                return False
            self.is_large = False
        else:
            self.is_large = True
        self.is_noisy = True
        is_reached = False
        for axis in range(3):
            if self._is_at_rail(axis, now[axis], last[axis]):
                is_reached = True
            if self._has_wrapped(axis, now[axis], last[axis], step_s):
                is_reached = self.is_large = True
        return is_reached

    def _is_at_rail(self, axis: int, value: float, last: float) -> bool:
        size = abs(value)
        if value != last:
            self.changes[axis] += 1
        is_equal = value == last and size >= self.rail
        self.equal[axis] = self.equal[axis] + 1 if is_equal else 0
        is_noisy = self.changes[axis] >= NOISY_SAMPLES
        self.is_noisy = self.is_noisy and is_noisy
        # -32768 is further than 32767
        at_end = (1 - 1e-9) * self.field_end <= size <= (1 + 1e-4) * self.field_end
        return at_end or (is_noisy and self.equal[axis] >= RAIL_SAMPLES)

    def _has_wrapped(self, axis: int, value: float, last: float, step_s: float) -> bool:
        """Whether the true value is beyond the field's end: only there it goes on from the last."""
        span = 2.0 * self.field_end * (32768 / 32767)
        true_last = last + span * self.wraps[axis]
        wraps = round((true_last - value) / span)
        if wraps == 0 or not 0.0 < step_s <= LONGEST_STEP_S:
            self.wraps[axis] = 0
            return False
        true = value + span * wraps
        goes_on = abs(true - true_last) <= max(self.step, self.step_a_s * step_s)
        self.wraps[axis] = wraps if goes_on and abs(true) <= self.most else 0
        return self.wraps[axis] != 0


# Of common gyroscopes ranges begin at 250 deg/s, and no more than 4000 deg/s are sold; of common
# accelerometers at 4 g, and a shock may change it by 10 g between two readings.
GYROSCOPE_END = (4.3, 32.767, 70.0, RATE_STEP_RAD_S, RATE_STEP_RAD_S2)
ACCELEROMETER_END = (3.9 * G, 32.767 * G, 41.0 * G, 10.0 * G)


@dataclass(slots=True)
class SensorFaults:
    """Follows one IMU stream and finds the faults of its sensors."""

    gyr_end: RangeEnd = field(default_factory=lambda: RangeEnd(*GYROSCOPE_END))
    acc_end: RangeEnd = field(default_factory=lambda: RangeEnd(*ACCELEROMETER_END))
    stuck: StuckImu = field(default_factory=StuckImu)
    mag: StuckField = field(default_factory=StuckField)
    last: Readings = NOTHING
    last_us: int = 0
    good_gyr: Vec3 = ZERO_VEC3  # the last good rate
    good_us: int = 0
    blinding: Reason | None = None  # why and since when the vehicle may turn unseen
    blinding_us: int = 0
    blinded: tuple[Reason, float] | None = None  # why the last such stretch, and s

    def refusal(self, readings: Readings, raw_us: int) -> Reason | None:
        """Why a reading at ``raw_us`` on the vehicle's clock is no data; None if it is."""
        step_us = raw_us - self.last_us
        why: Reason | None = None
        if self.gyr_end.is_reached(readings.gyr_rad_s, MICROSECOND * step_us):
            why = Reason.GYROSCOPE_SATURATED
        if self.acc_end.is_reached(readings.acc_m_s2, MICROSECOND * step_us):
            why = Reason.ACCELEROMETER_SATURATED
        if why is None:
            why = self.stuck.refusal(readings, self.last, raw_us)
        if why is None and self.gyr_end.is_large and self._is_spike(readings.gyr_rad_s, raw_us):
            why = Reason.GYROSCOPE_SPIKE
        self.mag.observe(readings, self.last, raw_us, step_us)
        self.last, self.last_us = readings, raw_us
        if why is None:
            self.good_gyr, self.good_us = readings.gyr_rad_s, raw_us
            if self.blinding is not None:
                span_us = raw_us - self.blinding_us
                if span_us >= BLIND_US or span_us < 0:  # or the clock began anew
                    self.blinded = self.blinding, MICROSECOND * max(span_us, 0)
                self.blinding = None
        elif self.blinding is None and why in BLINDING:
            self.blinding, self.blinding_us = why, raw_us
        return why

    def take_blindness(self) -> tuple[Reason, float] | None:
        """Why, and for how many s, if this reading ended a stretch that hides a rotation; once."""
        blinded, self.blinded = self.blinded, None
        return blinded

    @property
    def mag_is_stuck(self) -> bool:
        """Whether the field of the last reading has not followed the vehicle's turning."""
        return self.mag.mag.is_proven

    def _is_spike(self, gyr: Vec3, raw_us: int) -> bool:
        """Whether the rate leapt away from the last good one, and the reading before did not."""
        if not (self.gyr_end.is_noisy and self.acc_end.is_noisy):
            return False
        elapsed_s = MICROSECOND * max(raw_us - self.good_us, 0)
        limit = max(RATE_STEP_RAD_S, RATE_STEP_RAD_S2 * elapsed_s)
        if largest(subtract(gyr, self.good_gyr)) <= limit:
            return False
        off = subtract(gyr, self.last.gyr_rad_s)
        # an axis that agrees to the last digit is at the end of its range, and no witness
        return largest(off) > limit or 0.0 in off
