"""Sensors that repeat themselves or have reached the end of their range.

Both give numbers that look like data and are none. Real sensors are noisy: equal
readings, one after the other, come from a driver that has stopped reading, and an
equal large value on one axis is the end of a range. But fields are coarse, and
simulators know rest without noise: so equal readings are refused only if what the
other sensors say cannot be true beside them.
"""

from functools import cache
from math import log, sqrt
from typing import Any, NamedTuple

import numpy as np

from drivers.samples.steady_turn import carries_weight, vector_after_turn, way_of_field
from estimator.compilation.compiled import compiled, inlined, is_compiled_code
from estimator.compilation.direct import direct, types_of
from estimator.geometry.quaternion import norm, subtract
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

# Why a reading is no data, as compiled code says it. While readings are refused for one of those
# from BLINDING on the vehicle may turn unseen, and the first of them were believed, until the fault
# showed.
FINE, REPEATED, ACC_SATURATED, SPIKE, ZERO_ACC, MAG_STUCK = 0, 1, 2, 3, 4, 5
BLINDING, STUCK, GYR_STUCK, ACC_STUCK, GYR_SATURATED = 6, 6, 7, 8, 9
REASONS = (
    None,
    Reason.REPEATED,
    Reason.ACCELEROMETER_SATURATED,
    Reason.GYROSCOPE_SPIKE,
    Reason.ZERO_ACCELEROMETER,
    Reason.MAGNETOMETER_STUCK,
    Reason.STUCK,
    Reason.GYROSCOPE_STUCK,
    Reason.ACCELEROMETER_STUCK,
    Reason.GYROSCOPE_SATURATED,
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
LATEST_US = (1 << 63) - 1
MAG_TURN_RAD = 0.5  # turned so far, the field cannot be what it was


# Arrays of int64 and float64, or lists in plain Python.
Whole = Any
Numbers = Any

# The whole numbers that a stream is followed by: times of the last reading and of the last good
# one, for both sensors together, gyroscope and accelerometer how they repeat themselves,
LAST_US, GOOD_US, BOTH, GYR, ACC = 0, 1, 2, 6, 10
# which is changes, equal readings since the last one, when those began, and whether it is proven,
CHANGES, EQUAL, BEGIN_US, PROVEN = 0, 1, 2, 3
# when the field was looked at first since both repeat themselves, how the field repeats itself,
FIELD_US, MAG_CHANGES, MAG_EQUAL, MAG_SINCE_US = 14, 15, 16, 17
# of each axis the changes and the readings at a rail, what follows from them,
AXIS_CHANGES, RAILS, IS_NOISY, WAS_LARGE = 18, 24, 30, 31
# why and since when the vehicle may turn unseen, and the last such stretch.
BLIND, BLIND_SINCE_US, BLINDED, BLINDED_US = 32, 33, 34, 35
WHOLE_SIZE = 36
# And the others: the last readings, of each repetition how many pairs differ and are equal, the
# field at its first look, all readings when the gyroscope began to repeat itself, where it says
# that the repeated force should be, the last good rate, and the turn without a new field.
LAST, SHARES, FIELD, GYR_BEGIN, TURNED, GOOD, MAG_TURN = 0, 9, 15, 18, 27, 30, 33
NUMBERS_SIZE = 34


class Readings(NamedTuple):
    """One IMU message's vectors."""

    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


class Blindness(NamedTuple):
    """A stretch of refused readings: why, and for how long."""

    reason: Reason
    span_us: int


@inlined
def three(numbers: Numbers, at: int) -> Vec3:
    """A vector among the numbers."""
    return (numbers[at], numbers[at + 1], numbers[at + 2])


@inlined
def write(numbers: Numbers, at: int, v: Vec3) -> None:
    """Put a vector among the numbers."""
    numbers[at], numbers[at + 1], numbers[at + 2] = v


@inlined
def is_equal(one: Vec3, other: Vec3) -> bool:
    """Whether two vectors are the same to the last digit."""
    return one[0] == other[0] and one[1] == other[1] and one[2] == other[2]


@inlined
def largest(v: Vec3) -> float:
    """The largest part of a vector, without its sign."""
    return max(abs(v[0]), abs(v[1]), abs(v[2]))


@inlined
def judge(whole: Whole, numbers: Numbers, gyr: Vec3, acc: Vec3, mag: Vec3, raw_us: int) -> int:
    """Why a reading at ``raw_us`` on the vehicle's clock is no data; :data:`FINE` if it is."""
    why = saturation(whole, numbers, gyr, acc)
    if why == FINE:
        why = repetition(whole, numbers, gyr, acc, mag, raw_us)
    if why == FINE and whole[WAS_LARGE] == 1 and is_spike(whole, numbers, gyr, raw_us):
        why = SPIKE
    follow_mag(whole, numbers, gyr, mag, raw_us)
    write(numbers, LAST, gyr)
    write(numbers, LAST + 3, acc)
    write(numbers, LAST + 6, mag)
    whole[LAST_US] = raw_us
    if why == FINE:
        write(numbers, GOOD, gyr)
        whole[GOOD_US] = raw_us
        see_again(whole, raw_us)
    elif whole[BLIND] == FINE and why >= BLINDING:
        whole[BLIND], whole[BLIND_SINCE_US] = why, raw_us
    return why


@inlined
def see_again(whole: Whole, raw_us: int) -> None:
    """A good reading ends the stretch in which the vehicle may have turned unseen."""
    span_us = raw_us - whole[BLIND_SINCE_US]
    if whole[BLIND] != FINE and (span_us >= BLIND_US or span_us < 0):  # or the clock began anew
        whole[BLINDED], whole[BLINDED_US] = whole[BLIND], max(span_us, 0)
    whole[BLIND] = FINE


@inlined
def saturation(whole: Whole, numbers: Numbers, gyr: Vec3, acc: Vec3) -> int:
    """Whether a sensor is at the end of its range."""
    is_small = largest(gyr) < GYR_RAIL_RAD_S and largest(acc) < ACC_RAIL_M_S2
    if is_small and whole[IS_NOISY] == 1:  # nearly always
        if whole[WAS_LARGE] == 1:
            for axis in range(6):
                whole[RAILS + axis] = 0
        whole[WAS_LARGE] = 0
        return FINE
    whole[WAS_LARGE], whole[IS_NOISY], found = 0 if is_small else 1, 1, FINE
    for axis in range(3):
        if is_at_end(whole, axis, gyr[axis], numbers[LAST + axis], GYR_RAIL_RAD_S, GYR_END_RAD_S):
            found = GYR_SATURATED
    for axis in range(3):
        last = numbers[LAST + 3 + axis]
        if is_at_end(whole, 3 + axis, acc[axis], last, ACC_RAIL_M_S2, ACC_END_M_S2):
            found = ACC_SATURATED
    return found


@inlined
def is_at_end(whole: Whole, axis: int, value: float, last: float, rail: float, end: float) -> bool:
    """Whether one axis is at its end; also counts its changes, which show that it has noise."""
    size = abs(value)
    whole[RAILS + axis] = whole[RAILS + axis] + 1 if value == last and size >= rail else 0
    if value != last:
        whole[AXIS_CHANGES + axis] = min(whole[AXIS_CHANGES + axis] + 1, NOISY_SAMPLES)
    is_noisy = whole[AXIS_CHANGES + axis] >= NOISY_SAMPLES
    if not is_noisy:
        whole[IS_NOISY] = 0
    at_end = (1 - 1e-9) * end <= size <= (1 + 1e-4) * end  # -32768 is further than 32767
    return bool(at_end or (is_noisy and whole[RAILS + axis] >= RAIL_SAMPLES))


@inlined
def repetition(whole: Whole, numbers: Numbers, gyr: Vec3, acc: Vec3, mag: Vec3, raw_us: int) -> int:
    """Whether what is repeated cannot be true."""
    gyr_equal = is_equal(gyr, three(numbers, LAST))
    acc_equal = is_equal(acc, three(numbers, LAST + 3))
    is_long_both = follow(whole, numbers, BOTH, SHARES, gyr_equal and acc_equal, raw_us)
    if not (gyr_equal and acc_equal):
        write(numbers, FIELD, mag)
        whole[FIELD_US] = raw_us
    if not gyr_equal:
        write(numbers, GYR_BEGIN, gyr)
        write(numbers, GYR_BEGIN + 3, acc)
        write(numbers, GYR_BEGIN + 6, mag)
    is_long_gyr = follow(whole, numbers, GYR, SHARES + 2, gyr_equal, raw_us)
    is_long_acc = follow(whole, numbers, ACC, SHARES + 4, acc_equal, raw_us)
    follow_turned(whole, numbers, acc_equal, gyr, acc, raw_us)
    if is_long_both and repeats_untruly(whole, numbers, gyr, acc, mag, raw_us):
        whole[BOTH + PROVEN] = 1
    if is_long_acc and apart_rad(three(numbers, TURNED), acc) > STUCK_ACC_RAD:
        whole[ACC + PROVEN] = 1
    if is_long_gyr and has_turned_otherwise(whole, numbers, gyr, acc, mag, raw_us):
        whole[GYR + PROVEN] = 1
    if whole[BOTH + PROVEN] == 1:
        return STUCK
    if whole[ACC + PROVEN] == 1:
        return ACC_STUCK
    if whole[GYR + PROVEN] == 1:
        return GYR_STUCK
    return REPEATED if is_unlikely(whole, numbers, raw_us) else FINE


@inlined
def follow(
    whole: Whole, numbers: Numbers, at: int, shares: int, repeats: bool, raw_us: int
) -> bool:
    """Whether a noisy sensor has repeated itself for long enough to look closer."""
    if not repeats:
        whole[at + CHANGES] += 1
        if numbers[shares] >= SHARE_CHANGES:
            numbers[shares] *= 0.5
            numbers[shares + 1] *= 0.5
        numbers[shares] += 1.0
        numbers[shares + 1] += whole[at + EQUAL]
        whole[at + EQUAL], whole[at + BEGIN_US], whole[at + PROVEN] = 0, raw_us, 0
        return False
    whole[at + EQUAL] += 1
    whole[at + BEGIN_US] = min(whole[at + BEGIN_US], raw_us)
    is_long = raw_us - whole[at + BEGIN_US] >= STUCK_US and whole[at + EQUAL] >= STUCK_SAMPLES
    return bool(is_long and whole[at + CHANGES] >= NOISY_SAMPLES)


@inlined
def is_unlikely(whole: Whole, numbers: Numbers, raw_us: int) -> bool:
    """Whether chance does not explain the gyroscope's equal readings, before others do."""
    equal, lasts_us = whole[GYR + EQUAL], raw_us - whole[GYR + BEGIN_US]
    is_noisy = whole[GYR + CHANGES] >= NOISY_SAMPLES
    if equal < HELD_SAMPLES or not is_noisy or lasts_us > HELD_US:
        return False
    if equal >= STUCK_SAMPLES and lasts_us >= STUCK_US:
        return False
    changed, repeated = numbers[SHARES + 2], numbers[SHARES + 3]
    return bool(equal * log(repeated / (repeated + changed)) < log(BY_CHANCE))


@inlined
def follow_turned(
    whole: Whole, numbers: Numbers, acc_equal: bool, gyr: Vec3, acc: Vec3, raw_us: int
) -> None:
    """Turn the repeated specific force as the gyroscope says (dv/dt = v x w).

    In a steady turn it stays as it is.
    """
    if not acc_equal:
        write(numbers, TURNED, acc)
    elif largest(gyr) > MOVING_GYR_RAD_S and not carries_weight(acc, gyr):
        step_s = min(max(1e-6 * (raw_us - whole[LAST_US]), 0.0), LONGEST_STEP_S)
        write(numbers, TURNED, vector_after_turn(three(numbers, TURNED), gyr, step_s))


@inlined
def repeats_untruly(
    whole: Whole, numbers: Numbers, gyr: Vec3, acc: Vec3, mag: Vec3, raw_us: int
) -> bool:
    """Whether what gyroscope and accelerometer repeat cannot be true."""
    knows_field = not (is_equal(mag, ZERO_VEC3) or is_equal(three(numbers, FIELD), ZERO_VEC3))
    if largest(gyr) <= MOVING_GYR_RAD_S:
        is_heavier = abs(norm(acc) - STANDARD_GRAVITY_M_S2) > MOVING_ACC_M_S2
        return is_heavier or (knows_field and field_contradicts(whole, numbers, gyr, mag, raw_us))
    if not carries_weight(acc, gyr):
        return True
    if knows_field:
        return field_contradicts(whole, numbers, gyr, mag, raw_us)
    return bool(raw_us - whole[BOTH + BEGIN_US] >= STEADY_US)


@inlined
def field_contradicts(whole: Whole, numbers: Numbers, gyr: Vec3, mag: Vec3, raw_us: int) -> bool:
    """Whether the field of a reading is not where the repeated rate has turned it."""
    span_s = 1e-6 * max(raw_us - whole[FIELD_US], 0)  # the clock may have begun anew
    contradicts, is_far = way_of_field(three(numbers, FIELD), mag, gyr, span_s)
    if is_far and not contradicts:
        write(numbers, FIELD, mag)
        whole[FIELD_US] = raw_us
    return contradicts


@inlined
def has_turned_otherwise(
    whole: Whole, numbers: Numbers, gyr: Vec3, acc: Vec3, mag: Vec3, raw_us: int
) -> bool:
    """Whether accelerometer and field are not where the repeated rate would have them."""
    span_s = 1e-6 * (raw_us - whole[GYR + BEGIN_US])
    begin_acc, begin_mag = three(numbers, GYR_BEGIN + 3), three(numbers, GYR_BEGIN + 6)
    acc_rad = apart_rad(vector_after_turn(begin_acc, gyr, span_s), acc)
    is_steady = carries_weight(begin_acc, gyr)  # then the force stays as it is
    if is_steady:
        acc_rad = min(acc_rad, apart_rad(begin_acc, acc))
    if is_equal(mag, ZERO_VEC3) or is_equal(begin_mag, ZERO_VEC3):
        return acc_rad > STUCK_GYR_ALONE_RAD
    mag_rad = apart_rad(vector_after_turn(begin_mag, gyr, span_s), mag)
    if is_steady and mag_rad > STUCK_GYR_ALONE_RAD:
        return True  # one steady turn feels like another
    return min(acc_rad, mag_rad) > STUCK_GYR_RAD


@inlined
def is_spike(whole: Whole, numbers: Numbers, gyr: Vec3, raw_us: int) -> bool:
    """Whether the rate leapt away from the last good one, and the reading before did not."""
    if whole[IS_NOISY] == 0:
        return False
    limit = max(SPIKE_RAD_S, SPIKE_RAD_S2 * 1e-6 * max(raw_us - whole[GOOD_US], 0))
    if largest(subtract(gyr, three(numbers, GOOD))) <= limit:
        return False
    off = subtract(gyr, three(numbers, LAST))
    # an axis that agrees to the last digit is at the end of its range, and no witness
    return bool(largest(off) > limit or off[0] == 0.0 or off[1] == 0.0 or off[2] == 0.0)


@inlined
def follow_mag(whole: Whole, numbers: Numbers, gyr: Vec3, mag: Vec3, raw_us: int) -> None:
    """Count the field's equal readings, and how far the vehicle turns meanwhile."""
    if is_equal(mag, ZERO_VEC3) or not is_equal(mag, three(numbers, LAST + 6)):
        whole[MAG_CHANGES] = min(whole[MAG_CHANGES] + 1, NOISY_SAMPLES)
        whole[MAG_EQUAL], whole[MAG_SINCE_US], numbers[MAG_TURN] = 0, raw_us, 0.0
        return
    whole[MAG_EQUAL] += 1
    step_s = 1e-6 * min(max(raw_us - whole[LAST_US], 0), MAG_STUCK_US)
    numbers[MAG_TURN] += step_s * largest(gyr)


@inlined
def mag_is_stuck(whole: Whole, numbers: Numbers) -> bool:
    """Whether the field of the last reading has not followed the vehicle's turning."""
    is_long = whole[LAST_US] - whole[MAG_SINCE_US] >= MAG_STUCK_US
    is_repeated = whole[MAG_EQUAL] >= MAG_STUCK_SAMPLES and whole[MAG_CHANGES] >= NOISY_SAMPLES
    return bool(is_long and is_repeated and numbers[MAG_TURN] >= MAG_TURN_RAD)


@inlined
def apart_rad(one: Vec3, other: Vec3) -> float:
    """About the angle between two directions, up to 2 for opposite ones."""
    a, b = norm(one), norm(other)
    if a == 0.0 or b == 0.0:
        return 0.0
    x, y, z = one[0] / a - other[0] / b, one[1] / a - other[1] / b, one[2] / a - other[2] / b
    return sqrt(x * x + y * y + z * z)


def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`judge_reading` is called with."""
    return types_of(np.zeros(0, np.int64), np.zeros(0), *(0.0,) * 9, 0)


@compiled(types=argument_types)
def judge_reading(
    whole: Whole,
    numbers: Numbers,
    gx: float,
    gy: float,
    gz: float,
    ax: float,
    ay: float,
    az: float,
    mx: float,
    my: float,
    mz: float,
    raw_us: int,
) -> int:
    """See :func:`judge`; plain numbers cost the least to hand over."""
    return judge(whole, numbers, (gx, gy, gz), (ax, ay, az), (mx, my, mz), raw_us)


class SensorFaults:
    """Follows one IMU stream; bounded, a few numbers."""

    def __init__(self) -> None:
        has_code = is_compiled_code()
        self.whole: Whole = np.zeros(WHOLE_SIZE, np.int64) if has_code else [0] * WHOLE_SIZE
        self.numbers: Numbers = np.zeros(NUMBERS_SIZE) if has_code else [0.0] * NUMBERS_SIZE
        for share in range(SHARES, FIELD):
            self.numbers[share] = 1.0

    def refusal(self, readings: Readings, raw_us: int) -> Reason | None:
        """Why a reading at ``raw_us`` on the vehicle's clock is no data; None if it is."""
        gyr, acc, mag = readings
        step = _judge()
        time_us = min(raw_us, LATEST_US)  # a field of 64 bits holds twice as much
        return REASONS[step(self.whole, self.numbers, *gyr, *acc, *mag, time_us)]

    def take_blindness(self) -> Blindness | None:
        """The stretch that ended with this reading, if it hides a rotation; given once."""
        reason, span_us = REASONS[self.whole[BLINDED]], int(self.whole[BLINDED_US])
        self.whole[BLINDED] = FINE
        return None if reason is None else Blindness(reason, span_us)

    @property
    def mag_is_stuck(self) -> bool:
        """Whether the field of the last reading has not followed the vehicle's turning."""
        return mag_is_stuck(self.whole, self.numbers)


@cache
def _judge() -> Any:
    return direct(judge_reading, argument_types())
