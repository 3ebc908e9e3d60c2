"""Sensors that repeat themselves or have reached the end of their range.

Both give numbers that look like data and are none. Real sensors are noisy: equal
readings, one after the other, come from a driver that has stopped reading, and an
equal large value on one axis is the end of a range. But fields are coarse, and
simulators know rest without noise: so equal readings are refused only if what the
other sensors say cannot be true beside them.
"""

from collections.abc import Sequence
from math import dist, hypot, log
from operator import eq
from typing import NamedTuple

from drivers.samples.steady_turn import FieldWatch, carries_weight, vector_after_turn
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

# The messages' 16-bit fields end here: 32.767 rad/s and g
GYR_END_RAD_S = 32.767
ACC_END_M_S2 = 32.767 * STANDARD_GRAVITY_M_S2
# The ranges of common IMUs begin at 250 deg/s and 4 g; below that, equal values are no rail
GYR_RAIL_RAD_S = 4.3
ACC_RAIL_M_S2 = 3.9 * STANDARD_GRAVITY_M_S2
RAIL_SAMPLES = 4

# No vehicle changes its rate so fast: such a reading is refused unless the next one agrees with it
SPIKE_RAD_S = 10.0
SPIKE_RAD_S2 = 500.0

# While readings are refused for these reasons the vehicle may turn unseen, and the first of them
# were believed, until the fault showed
BLIND_REASONS = frozenset(
    {Reason.STUCK, Reason.GYROSCOPE_STUCK, Reason.ACCELEROMETER_STUCK, Reason.GYROSCOPE_SATURATED}
)
BLIND_US = 30_000  # from the first refused reading on

# Of a sensor that hardly ever repeats itself, equal readings are held back at once, as if none had
# come: when chance would bring so many in a row less than once in 1e8 times. So rarely, since a
# smooth motion in coarse digits repeats itself more often than chance does.
BY_CHANCE = 1e-8
HELD_SAMPLES = 3  # at least
HELD_US = 2_000_000  # at most; by then it is known whether it is stuck
SHARE_CHANGES = 200  # the share of equal readings goes back over so many changes

STUCK_SAMPLES = 20  # equal readings
STUCK_US = 500_000
# Where there is no field, a steady turn explains equal readings for so long; noise ends it earlier
STEADY_US = 3_000_000
# One sensor alone is stuck once the others say that the vehicle has turned this far, in radians
STUCK_ACC_RAD = 0.35  # of what the gyroscope says; below MOVING_GYR it may be its bias
STUCK_GYR_RAD = 0.17  # of both the accelerometer and the magnetometer
STUCK_GYR_ALONE_RAD = 0.5  # of one of them, where the other cannot tell: no braking does that
LONGEST_STEP_S = 0.1
# What no vehicle at rest shows: more than a gyroscope's bias, not 1 g
MOVING_GYR_RAD_S = 0.05
MOVING_ACC_M_S2 = 0.5
NOISY_SAMPLES = 50  # that many changes before prove that the sensor has noise
MAG_STUCK_SAMPLES = 20
MAG_STUCK_US = 2_000_000
MAG_TURN_RAD = 0.5  # turned so far, the field cannot be what it was


class Readings(NamedTuple):
    """One IMU message's vectors."""

    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


class Blindness(NamedTuple):
    """A stretch of refused readings: why, and for how long."""

    reason: Reason
    span_us: int


class _Repetition:
    """Follows one sensor's equal readings."""

    def __init__(self) -> None:
        self.begin_us = 0
        self.is_proven = False  # it is stuck, until it changes
        self._changes = 0
        self._equal = 0
        self._changed = 1.0  # of the latest pairs of readings, how many differ,
        self._repeated = 1.0  # and how many are equal

    def follow(self, is_equal: bool, raw_us: int) -> bool:
        """Whether a noisy sensor has repeated itself for long enough to look closer."""
        if not is_equal:
            self._changes += 1
            self._count(self._equal)
            self._equal, self.begin_us = 0, raw_us
            self.is_proven = False
            return False
        self._equal += 1
        self.begin_us = min(self.begin_us, raw_us)
        return (
            self._equal >= STUCK_SAMPLES
            and self._changes >= NOISY_SAMPLES
            and raw_us - self.begin_us >= STUCK_US
        )

    def is_unlikely(self, raw_us: int) -> bool:
        """Whether chance does not explain the equal readings, before it is known what does."""
        lasts_us = raw_us - self.begin_us
        if self._equal < HELD_SAMPLES or self._changes < NOISY_SAMPLES or lasts_us > HELD_US:
            return False
        if self._equal >= STUCK_SAMPLES and lasts_us >= STUCK_US:
            return False
        share = self._repeated / (self._repeated + self._changed)
        return self._equal * log(share) < log(BY_CHANCE)

    def numbers(self) -> tuple[tuple[int, int, int], tuple[float, float]]:
        """All that changes while nothing is proven."""
        return (self._changes, self._equal, self.begin_us), (self._changed, self._repeated)

    def resume(self, whole: Sequence[int], shares: Sequence[float]) -> None:
        """Go on from :meth:`numbers`."""
        self._changes, self._equal, self.begin_us = whole
        self._changed, self._repeated = shares
        self.is_proven = False

    def _count(self, equal: int) -> None:
        if self._changed >= SHARE_CHANGES:
            self._changed *= 0.5
            self._repeated *= 0.5
        self._changed += 1.0
        self._repeated += equal


class SensorFaults:
    """Follows one IMU stream; bounded, a few numbers."""

    def __init__(self) -> None:
        self._last = Readings(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
        self._both = _Repetition()
        self._field = FieldWatch()  # since both repeat themselves
        self._gyr = _Repetition()
        self._gyr_begin = self._last  # what all said when the gyroscope began to repeat itself
        self._acc = _Repetition()
        self._turned_acc = ZERO_VEC3  # where the gyroscope says the repeated reading should be
        self._rails = [0] * 6
        self._axis_changes = [0] * 6
        self._is_noisy = False  # every axis has shown noise
        self._was_large = False  # the last reading was in the region of rails
        self._last_us = 0
        self._good_gyr = ZERO_VEC3
        self._good_us = 0
        self._blind_since: tuple[Reason, int] | None = None
        self._blindness: Blindness | None = None
        self._mag_changes = 0
        self._mag_equal = 0
        self._mag_since_us = 0
        self._mag_turn_rad = 0.0

    def refusal(self, readings: Readings, raw_us: int) -> Reason | None:
        """Why a reading at ``raw_us`` on the vehicle's clock is no data; None if it is."""
        refusal = self._saturation(readings) or self._repetition(readings, raw_us)
        if refusal is None and self._was_large and self._is_spike(readings.gyr_rad_s, raw_us):
            refusal = Reason.GYROSCOPE_SPIKE
        self._follow_mag(readings, raw_us)
        self._last, self._last_us = readings, raw_us
        if refusal is None:
            self._good_gyr, self._good_us = readings.gyr_rad_s, raw_us
            if self._blind_since is not None:
                self._see_again(*self._blind_since, raw_us)
        elif self._blind_since is None and refusal in BLIND_REASONS:
            self._blind_since = refusal, raw_us
        return refusal

    def take_blindness(self) -> Blindness | None:
        """The stretch that ended with this reading, if it hides a rotation; given once."""
        blindness, self._blindness = self._blindness, None
        return blindness

    def _see_again(self, reason: Reason, since_us: int, raw_us: int) -> None:
        self._blind_since = None
        span_us = raw_us - since_us
        if span_us >= BLIND_US or span_us < 0:  # or the clock began anew
            self._blindness = Blindness(reason, max(span_us, 0))

    def numbers(self) -> tuple[list[int], list[float]] | None:
        """What changes while readings are sound and follow sound ones; None if they do not.

        In the columns of :mod:`drivers.samples.going_on`.
        """
        parts = (self._both, self._gyr, self._acc)
        is_sound = not self._was_large and not any(p.is_proven for p in parts)
        if not is_sound or self._blind_since is not None or self._blindness is not None:
            return None
        (both, both_shares), (gyr, gyr_shares), (acc, acc_shares) = (p.numbers() for p in parts)
        field_gauss, field_us = self._field.begun
        whole = [self._last_us, self._good_us, *both, *gyr, *acc, field_us]
        whole += [self._mag_changes, self._mag_equal, self._mag_since_us, *self._axis_changes]
        numbers = [*_flat(self._last), *both_shares, *gyr_shares, *acc_shares, *field_gauss]
        numbers += [*_flat(self._gyr_begin), *self._turned_acc, *self._good_gyr]
        return whole, [*numbers, self._mag_turn_rad]

    def resume(self, whole: list[int], numbers: list[float]) -> None:
        """Go on from :meth:`numbers`."""
        self._last_us, self._good_us, *repetitions = whole
        for k, part in enumerate((self._both, self._gyr, self._acc)):
            part.resume(repetitions[3 * k : 3 * k + 3], numbers[9 + 2 * k : 11 + 2 * k])
        self._mag_changes, self._mag_equal, self._mag_since_us, *axes = repetitions[10:]
        self._axis_changes, self._is_noisy = axes, min(axes) >= NOISY_SAMPLES
        self._last, self._gyr_begin = _readings(numbers[:9]), _readings(numbers[18:27])
        self._field.begin(_vec3(numbers[15:18]), repetitions[9])
        self._turned_acc, self._good_gyr = _vec3(numbers[27:30]), _vec3(numbers[30:33])
        self._mag_turn_rad = numbers[33]

    @property
    def mag_is_stuck(self) -> bool:
        """Whether the field of the last reading has not followed the vehicle's turning."""
        return (
            self._mag_equal >= MAG_STUCK_SAMPLES
            and self._mag_changes >= NOISY_SAMPLES
            and self._last_us - self._mag_since_us >= MAG_STUCK_US
            and self._mag_turn_rad >= MAG_TURN_RAD
        )

    def _repetition(self, readings: Readings, raw_us: int) -> Reason | None:
        gyr_equal = readings.gyr_rad_s == self._last.gyr_rad_s
        acc_equal = readings.acc_m_s2 == self._last.acc_m_s2
        both, gyr, acc = self._both, self._gyr, self._acc
        is_long_both = both.follow(gyr_equal and acc_equal, raw_us)
        if not (gyr_equal and acc_equal):
            self._field.begin(readings.mag_gauss, raw_us)
        if not gyr_equal:
            self._gyr_begin = readings
        is_long_gyr = gyr.follow(gyr_equal, raw_us)
        is_long_acc = acc.follow(acc_equal, raw_us)
        self._follow_turned_acc(acc_equal, readings, raw_us)
        if is_long_both:
            both.is_proven = both.is_proven or self._repeats_untruly(readings, raw_us)
        if is_long_acc:
            apart_rad = _apart_rad(self._turned_acc, readings.acc_m_s2)
            acc.is_proven = acc.is_proven or apart_rad > STUCK_ACC_RAD
        if is_long_gyr:
            gyr.is_proven = gyr.is_proven or self._has_turned_otherwise(readings, raw_us)
        if both.is_proven:
            return Reason.STUCK
        if acc.is_proven:
            return Reason.ACCELEROMETER_STUCK
        if gyr.is_proven:
            return Reason.GYROSCOPE_STUCK
        return Reason.REPEATED if gyr.is_unlikely(raw_us) else None

    def _follow_turned_acc(self, is_equal: bool, readings: Readings, raw_us: int) -> None:
        """Turn the repeated specific force as the gyroscope says (dv/dt = v x w).

        In a steady turn it stays as it is.
        """
        if not is_equal:
            self._turned_acc = readings.acc_m_s2
            return
        gyr = readings.gyr_rad_s
        if max(map(abs, gyr)) <= MOVING_GYR_RAD_S or carries_weight(readings.acc_m_s2, gyr):
            return
        step_s = min(max(1e-6 * (raw_us - self._last_us), 0.0), LONGEST_STEP_S)
        self._turned_acc = vector_after_turn(self._turned_acc, gyr, step_s)

    def _repeats_untruly(self, readings: Readings, raw_us: int) -> bool:
        """Whether what gyroscope and accelerometer repeat cannot be true."""
        gyr, acc = readings.gyr_rad_s, readings.acc_m_s2
        if max(map(abs, gyr)) <= MOVING_GYR_RAD_S:
            is_heavier = abs(hypot(*acc) - STANDARD_GRAVITY_M_S2) > MOVING_ACC_M_S2
            return is_heavier or self._field_contradicts(readings, raw_us)
        if not carries_weight(acc, gyr) or self._field_contradicts(readings, raw_us):
            return True
        lasts_us = raw_us - self._both.begin_us
        return lasts_us >= STEADY_US and not self._field.knows(readings.mag_gauss)

    def _field_contradicts(self, readings: Readings, raw_us: int) -> bool:
        mag = readings.mag_gauss
        return self._field.knows(mag) and self._field.contradicts(mag, readings.gyr_rad_s, raw_us)

    def _has_turned_otherwise(self, readings: Readings, raw_us: int) -> bool:
        """Whether accelerometer and field are not where the repeated rate would have them."""
        begin, span_s = self._gyr_begin, 1e-6 * (raw_us - self._gyr.begin_us)
        gyr = readings.gyr_rad_s
        acc_rad = _apart_rad(vector_after_turn(begin.acc_m_s2, gyr, span_s), readings.acc_m_s2)
        is_steady = carries_weight(begin.acc_m_s2, gyr)  # then the force stays as it is
        if is_steady:
            acc_rad = min(acc_rad, _apart_rad(begin.acc_m_s2, readings.acc_m_s2))
        if ZERO_VEC3 in (readings.mag_gauss, begin.mag_gauss):
            return acc_rad > STUCK_GYR_ALONE_RAD
        mag_rad = _apart_rad(vector_after_turn(begin.mag_gauss, gyr, span_s), readings.mag_gauss)
        if is_steady and mag_rad > STUCK_GYR_ALONE_RAD:
            return True  # one steady turn feels like another
        return min(acc_rad, mag_rad) > STUCK_GYR_RAD

    def _saturation(self, readings: Readings) -> Reason | None:
        gyr, acc = readings.gyr_rad_s, readings.acc_m_s2
        is_small = (
            min(gyr) > -GYR_RAIL_RAD_S
            and max(gyr) < GYR_RAIL_RAD_S
            and min(acc) > -ACC_RAIL_M_S2
            and max(acc) < ACC_RAIL_M_S2
        )
        if is_small and self._is_noisy:  # nearly always
            if self._was_large:
                self._rails, self._was_large = [0] * 6, False
            return None
        self._was_large = not is_small
        found = None
        axes = (*gyr, *acc)
        before = (*self._last.gyr_rad_s, *self._last.acc_m_s2)
        for axis, (value, last) in enumerate(zip(axes, before, strict=True)):
            is_gyr = axis < 3
            size = abs(value)
            at_rail = value == last and size >= (GYR_RAIL_RAD_S if is_gyr else ACC_RAIL_M_S2)
            self._rails[axis] = self._rails[axis] + 1 if at_rail else 0
            if value != last:
                self._axis_changes[axis] = min(self._axis_changes[axis] + 1, NOISY_SAMPLES)
            is_noisy = self._axis_changes[axis] >= NOISY_SAMPLES
            end = GYR_END_RAD_S if is_gyr else ACC_END_M_S2
            at_end = (1 - 1e-9) * end <= size <= (1 + 1e-4) * end  # -32768 is further than 32767
            if at_end or (is_noisy and self._rails[axis] >= RAIL_SAMPLES):
                found = Reason.GYROSCOPE_SATURATED if is_gyr else Reason.ACCELEROMETER_SATURATED
        self._is_noisy = min(self._axis_changes) >= NOISY_SAMPLES
        return found

    def _is_spike(self, gyr: Vec3, raw_us: int) -> bool:
        """Whether the rate leapt away from the last good one, and the reading before did not."""
        if not self._is_noisy:
            return False
        limit = max(SPIKE_RAD_S, SPIKE_RAD_S2 * 1e-6 * max(raw_us - self._good_us, 0))
        if _farthest(gyr, self._good_gyr) <= limit:
            return False
        before = self._last.gyr_rad_s
        # an axis that agrees to the last digit is at the end of its range, and no witness
        return _farthest(gyr, before) > limit or any(map(eq, gyr, before))

    def _follow_mag(self, readings: Readings, raw_us: int) -> None:
        if readings.mag_gauss != self._last.mag_gauss or readings.mag_gauss == ZERO_VEC3:
            self._mag_changes = min(self._mag_changes + 1, NOISY_SAMPLES)
            self._mag_equal, self._mag_since_us, self._mag_turn_rad = 0, raw_us, 0.0
            return
        self._mag_equal += 1
        step_s = 1e-6 * min(max(raw_us - self._last_us, 0), MAG_STUCK_US)
        self._mag_turn_rad += step_s * max(map(abs, readings.gyr_rad_s))


def _flat(readings: Readings) -> tuple[float, ...]:
    return (*readings.gyr_rad_s, *readings.acc_m_s2, *readings.mag_gauss)


def _readings(numbers: list[float]) -> Readings:
    return Readings(_vec3(numbers[:3]), _vec3(numbers[3:6]), _vec3(numbers[6:]))


def _vec3(numbers: list[float]) -> Vec3:
    x, y, z = numbers
    return (x, y, z)


def _farthest(one: Vec3, other: Vec3) -> float:
    return max(abs(x - y) for x, y in zip(one, other, strict=True))


def _apart_rad(one: Vec3, other: Vec3) -> float:
    """About the angle between two directions, up to 2 for opposite ones."""
    one_norm, other_norm = hypot(*one), hypot(*other)
    if one_norm == 0.0 or other_norm == 0.0:
        return 0.0
    return dist([x / one_norm for x in one], [x / other_norm for x in other])
