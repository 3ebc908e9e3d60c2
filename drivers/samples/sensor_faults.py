"""Readings that look like data and are none: of sensors that are stuck, at their end, or leap.

Real sensors are noisy: equal readings, one after the other, come from a driver that has stopped
reading. But fields are coarse, and simulators know rest without noise: so equal readings are
refused only if the other sensors contradict them.
"""

from dataclasses import dataclass, field
from math import log, pi, radians
from typing import NamedTuple

from estimator.geometry.quaternion import (
    add,
    angle_between_vectors,
    dot,
    exp,
    norm,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2 as G
from estimator.types import ZERO_VEC3, Vec3

MICROSECOND = 1e-6
# While readings are refused for one of these the vehicle may turn unseen, and the first of them
# were believed, until the fault showed.
BLINDING = (
    *(Reason.STUCK, Reason.GYROSCOPE_STUCK),
    *(Reason.ACCELEROMETER_STUCK, Reason.GYROSCOPE_SATURATED),
)
BLIND_US = 30_000  # from the first refused reading on
RAIL_SAMPLES = 4  # equal large values
RATE_STEP_RAD_S, RATE_STEP_RAD_S2 = 10.0, 500.0  # no vehicle changes its rate faster

NOISY_SAMPLES = 50  # that many changes before prove that a sensor has noise
STUCK_SAMPLES, STUCK_US = 20, 500_000  # equal readings
SHARE_CHANGES = 200  # the share of equal readings goes back over so many changes
# Equal readings are unlikely where chance would bring so many in a row less than once in 1e8
# times. So rarely, since a smooth motion in coarse digits repeats itself more often than chance.
BY_CHANCE = 1e-8
HELD_SAMPLES = 3  # at least
HELD_US = 2_000_000  # unlikely readings at most; by then it is known whether it is stuck
FROZEN_US = 300_000  # so long a moving gyroscope does not repeat itself while others do not
# Where there is no field, a steady turn explains equal readings for so long; noise ends it earlier
STEADY_US = 3_000_000
# An accelerometer alone is stuck once the gyroscope shows that the vehicle has turned this far, in
# radians; below MOVING_GYR_RAD_S that may be its bias
STUCK_ACC_RAD = 0.35
LONGEST_STEP_S = 0.1
# What no vehicle at rest shows: more than a gyroscope's bias, not 1 g, force or field that turn
MOVING_GYR_RAD_S, MOVING_ACC_M_S2, MOVING_RAD = 0.05, 0.5, 0.1
DISTINCT_RAD = 0.05  # a turn so far stands out of noise
CONFIRMS_RAD = 0.25  # nearer than that to the turn by the rate, and half the way: it has turned so
WEIGHT_M_S2 = 0.5  # from 1 g, of the force along the axis of a steady turn
# Of the field's strength, and of the way that the rate gives it: so far off it may be, as hard iron
# bends the way
FIELD_OFF, FIELD_OFF_SHARE = 0.17, 0.5
FIELD_LATE_S = 0.15  # magnetometers follow 0.1 s late, in steps
FIELD_WAY = 0.5  # of the field's strength: having gone as far as by the rate, it begins anew
# Turned so far, the field cannot be what it was: by any turns in HELD_US; sooner, by what the rate
# comes to beyond a bias
MAG_PATH_RAD, MAG_TURN_RAD = 0.5, 0.1


class Readings(NamedTuple):
    """One IMU message's vectors, and its time on the vehicle's clock."""

    raw_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


NOTHING = Readings(0, ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
SPAN = 2.0 * 32768 / 32767  # of a 16-bit field from end to end, by its upper end


@dataclass(slots=True)
class RangeEnd:
    """Follows one sensor's three axes.

    Ranges begin to end at ``rail``, the messages' 16-bit fields at ``field_ends``. ``most`` is what
    the sensor can read at all, ``step`` with ``step_a_s`` what it changes by between two readings:
    more than ``longest_s`` apart a wrapped value and a fast change look alike.
    """

    rail: float
    field_ends: tuple[float, ...]
    most: float
    step: float
    step_a_s: float = 0.0
    longest_s: float = 0.05
    last: Vec3 = ZERO_VEC3
    changes: list[int] = field(default_factory=lambda: [0, 0, 0])  # of each axis: it has noise
    equal: list[int] = field(default_factory=lambda: [0, 0, 0])  # readings at a rail in a row
    wrapped: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # true less shown
    is_noisy: bool = False  # on all axes
    is_large: bool = False  # the latest reading, or not as small as it seems

    def is_reached(self, now: Vec3, step_s: float) -> bool:
        """Whether a reading, ``step_s`` after the last, is at an end or beyond."""
        was_large, last, self.last, rail = self.is_large, self.last, now, self.rail
        x, y, z = now
        self.is_large = not (-rail < x < rail and -rail < y < rail and -rail < z < rail)
        if self.is_noisy and not self.is_large and not was_large:  # nearly always
            return False
        self.is_noisy, is_reached = True, False
        for axis, value in enumerate(now):
            is_equal, size = value == last[axis], abs(value)
            self.changes[axis] += not is_equal
            self.equal[axis] = self.equal[axis] + 1 if is_equal and size >= rail else 0
            self.wrapped[axis] = self._wrapped(value, last[axis] + self.wrapped[axis], step_s)
            is_noisy = self.changes[axis] >= NOISY_SAMPLES
            # -32768 is further than 32767
            at_end = any((1 - 1e-9) * e <= size <= (1 + 1e-4) * e for e in self.field_ends)
            at_rail = is_noisy and self.equal[axis] >= RAIL_SAMPLES
            is_reached = is_reached or at_end or at_rail or self.wrapped[axis] != 0.0
            self.is_noisy = self.is_noisy and is_noisy
        self.is_large = self.is_large or any(self.wrapped)
        return is_reached

    def _wrapped(self, value: float, last: float, step_s: float) -> float:
        """What a value lacks that has wrapped: it goes on from the last true one only so."""
        for field_end in self.field_ends:
            span = SPAN * field_end
            lacks = span * round((last - value) / span)
            is_in_field = abs(value) <= (1 + 1e-4) * field_end
            if lacks == 0.0 or not is_in_field or not 0.0 < step_s <= self.longest_s:
                continue
            goes_on = abs(value + lacks - last) <= max(self.step, self.step_a_s * step_s)
            if goes_on and abs(value + lacks) <= self.most:
                return lacks
        return 0.0


# Fields have mrad/s or 0.1 deg/s, mg and mgauss. Of common gyroscopes ranges begin at 250 deg/s,
# and no more than 4000 deg/s are sold; of common accelerometers at 4 g, and a shock may change it
# by 10 g between two readings. No field near a vehicle is stronger than a magnet's surface.
GYROSCOPE_END = (4.3, (32.767, radians(3276.7)), 70.0, RATE_STEP_RAD_S, RATE_STEP_RAD_S2)
ACCELEROMETER_END = (3.9 * G, (32.767 * G,), 41.0 * G, 10.0 * G)
MAGNETOMETER_END = (16.0, (32.767,), 1000.0, 16.0, 0.0, 0.3)


@dataclass(slots=True)
class Repetition:
    """Counts a sensor's equal readings, and knows how often it repeats itself.

    ``is_proven`` is set where what is repeated cannot be true; the next change takes it back.
    """

    changes: int = 0
    equal: int = 0  # readings since the last change
    begin_us: int = 0  # when they began
    is_proven: bool = False
    changed: float = 1.0  # pairs of readings, lately
    repeated: float = 1.0

    def observe(self, raw_us: int, *, repeats: bool) -> None:
        """Take a reading's time, and whether it repeats the last."""
        if repeats:
            self.equal += 1
            self.begin_us = min(self.begin_us, raw_us)  # the clock may have begun anew
            return
        self.changes += 1
        if self.changed >= SHARE_CHANGES:
            self.changed *= 0.5
            self.repeated *= 0.5
        self.changed += 1.0
        self.repeated += self.equal
        self.equal, self.begin_us, self.is_proven = 0, raw_us, False

    def is_long(self, raw_us: int, least_us: int = STUCK_US) -> bool:
        """Whether a noisy sensor has repeated itself for long enough to look closer."""
        is_long = self.equal >= STUCK_SAMPLES and raw_us - self.begin_us >= least_us
        return is_long and self.changes >= NOISY_SAMPLES

    def is_unlikely(self) -> bool:
        """Whether chance does not explain the equal readings."""
        if self.equal < HELD_SAMPLES or self.changes < NOISY_SAMPLES:
            return False
        share = self.repeated / (self.repeated + self.changed)
        return self.equal * log(share) < log(BY_CHANCE)


@dataclass(slots=True)
class StuckSensors:
    """Finds sensors repeating what cannot be true, and a field that does not follow a turn."""

    both: Repetition = field(default_factory=Repetition)
    gyr: Repetition = field(default_factory=Repetition)
    acc: Repetition = field(default_factory=Repetition)
    mag: Repetition = field(default_factory=Repetition)
    last_us: int = 0  # of the last reading that was not saturated
    watched: Readings = NOTHING  # from there on the field must turn by the repeated rate
    gyr_begin: Readings = NOTHING  # when the gyroscope began to repeat itself
    turned: Vec3 = ZERO_VEC3  # where the repeated force should be by the gyroscope
    mag_path_rad: float = 0.0  # without a new field, turns to and fro alike
    mag_turn: Vec3 = ZERO_VEC3  # what they come to, rad
    mag_equal_s: float = 0.0

    def refusal(self, now: Readings, last: Readings) -> Reason | None:
        """Why the reading behind ``last`` cannot be true; saturated ones are not given."""
        raw_us, gyr, acc, _ = now
        gyr_equal, acc_equal = gyr == last.gyr_rad_s, acc == last.acc_m_s2
        step_us, self.last_us = raw_us - self.last_us, raw_us
        self.both.observe(raw_us, repeats=gyr_equal and acc_equal)
        self.gyr.observe(raw_us, repeats=gyr_equal)
        self.acc.observe(raw_us, repeats=acc_equal)
        if not acc_equal:
            self.turned = acc
        if not gyr_equal:
            self.gyr_begin = now
        if not (gyr_equal and acc_equal):
            self.watched = now
            if not (gyr_equal or acc_equal):  # nearly always
                return None
        if acc_equal and largest(gyr) > MOVING_GYR_RAD_S and not carries_weight(acc, gyr):
            # the repeated force turns by the gyroscope (dv/dt = v x w), but in a steady turn
            step_s = min(max(MICROSECOND * step_us, 0.0), LONGEST_STEP_S)
            self.turned = vector_after_turn(self.turned, gyr, step_s)
        return self._judge(now)

    def observe_field(self, now: Readings, last: Readings) -> None:
        """Take the field of the reading behind ``last``."""
        repeats = now.mag_gauss == last.mag_gauss and now.mag_gauss != ZERO_VEC3
        self.mag.observe(now.raw_us, repeats=repeats)
        if not repeats:
            self.mag_path_rad, self.mag_turn, self.mag_equal_s = 0.0, ZERO_VEC3, 0.0
            return
        step_s = MICROSECOND * min(max(now.raw_us - last.raw_us, 0), HELD_US)
        self.mag_path_rad += step_s * largest(now.gyr_rad_s)
        self.mag_turn = add(self.mag_turn, scale(step_s, now.gyr_rad_s))
        is_long = self.mag.is_long(now.raw_us, HELD_US)
        self.mag_equal_s += step_s
        by_bias_rad = MOVING_GYR_RAD_S * self.mag_equal_s
        has_turned = largest(self.mag_turn) > MAG_TURN_RAD + by_bias_rad
        is_stuck = has_turned and (is_long or self.mag.is_unlikely())
        if is_stuck or (is_long and self.mag_path_rad >= MAG_PATH_RAD):
            self.mag.is_proven = True

    def _judge(self, now: Readings) -> Reason | None:
        both, gyr, acc, raw_us = self.both, self.gyr, self.acc, now.raw_us
        if both.is_long(raw_us) and self._repeats_untruly(now):
            both.is_proven = True
        if acc.is_long(raw_us) and apart_rad(self.turned, now.acc_m_s2) > STUCK_ACC_RAD:
            acc.is_proven = True
        is_unlikely = gyr.is_unlikely()
        if is_unlikely and self._is_frozen(now):
            gyr.is_proven = True
        if both.is_proven:
            return Reason.STUCK
        if acc.is_proven:
            return Reason.ACCELEROMETER_STUCK
        if gyr.is_proven:
            return Reason.GYROSCOPE_STUCK
        lasts_us = raw_us - gyr.begin_us
        is_over = lasts_us > HELD_US or (gyr.equal >= STUCK_SAMPLES and lasts_us >= STUCK_US)
        return Reason.REPEATED if is_unlikely and not is_over else None

    def _repeats_untruly(self, now: Readings) -> bool:
        """Whether what gyroscope and accelerometer repeat cannot be true."""
        raw_us, gyr, acc, mag = now
        has_field = ZERO_VEC3 not in (mag, self.watched.mag_gauss)
        if largest(gyr) <= MOVING_GYR_RAD_S:
            is_heavier = abs(norm(acc) - G) > MOVING_ACC_M_S2
            return is_heavier or (has_field and self._field_contradicts(now))
        if not carries_weight(acc, gyr):
            return True
        if has_field:
            return self._field_contradicts(now)
        return raw_us - self.both.begin_us >= STEADY_US

    def _field_contradicts(self, now: Readings) -> bool:
        """Whether the field is not where the repeated rate has turned it.

        Well on its way it is watched from here on.
        """
        before, gyr = self.watched.mag_gauss, now.gyr_rad_s
        # the clock may have begun anew
        span_s = MICROSECOND * max(now.raw_us - self.watched.raw_us, 0)
        expected = vector_after_turn(before, gyr, span_s)
        way = norm(subtract(expected, before)) / norm(before)
        off = norm(subtract(expected, now.mag_gauss)) / norm(before)
        contradicts = off > max(FIELD_OFF + FIELD_LATE_S * norm(gyr), FIELD_OFF_SHARE * way)
        if way >= FIELD_WAY and not contradicts:
            self.watched = now
        return contradicts

    def _is_frozen(self, now: Readings) -> bool:
        """Whether the gyroscope alone has stopped, in a vehicle that moves otherwise."""
        span_us = now.raw_us - self.gyr.begin_us
        if span_us < FROZEN_US or 2 * self.acc.equal > self.gyr.equal:
            return False
        _, gyr, acc, mag = now
        begin, span_s = self.gyr_begin, MICROSECOND * span_us
        half_s = min(span_s, pi / max(norm(gyr), 1e-9))  # of a turn: no way is longer
        pairs = ((begin.acc_m_s2, acc), (begin.mag_gauss, mag))
        for before, after in pairs:
            expected = vector_after_turn(before, gyr, span_s)
            way_rad = apart_rad(before, vector_after_turn(before, gyr, half_s))
            near_rad = min(0.5 * way_rad, CONFIRMS_RAD)
            if way_rad >= DISTINCT_RAD and apart_rad(expected, after) < near_rad:
                return False  # it has turned by what the gyroscope measured
        moves = any(apart_rad(*pair) > MOVING_RAD for pair in pairs)
        return moves or largest(gyr) > MOVING_GYR_RAD_S


@dataclass(slots=True)
class SensorFaults:
    """Follows one IMU stream and finds the faults of its sensors."""

    gyr_end: RangeEnd = field(default_factory=lambda: RangeEnd(*GYROSCOPE_END))
    acc_end: RangeEnd = field(default_factory=lambda: RangeEnd(*ACCELEROMETER_END))
    mag_end: RangeEnd = field(default_factory=lambda: RangeEnd(*MAGNETOMETER_END))
    stuck: StuckSensors = field(default_factory=StuckSensors)
    last: Readings = NOTHING
    good: Readings = NOTHING  # the last that was not refused
    blinding: Reason | None = None  # why and since when the vehicle may turn unseen
    blinding_us: int = 0
    blinded: tuple[Reason, float] | None = None  # why the last such stretch, and s

    def true_field(self, mag_gauss: Vec3, raw_us: int) -> Vec3:
        """The field of the reading that is judged next, as it was before it wrapped."""
        step_s = MICROSECOND * (raw_us - self.last.raw_us)
        if mag_gauss == ZERO_VEC3 or not self.mag_end.is_reached(mag_gauss, step_s):
            return mag_gauss
        x, y, z = mag_gauss
        lacks_x, lacks_y, lacks_z = self.mag_end.wrapped
        return (x + lacks_x, y + lacks_y, z + lacks_z)

    def refusal(self, now: Readings) -> Reason | None:
        """Why a reading is no data; None if it is."""
        last, why = self.last, None
        step_s = MICROSECOND * (now.raw_us - last.raw_us)
        self.stuck.observe_field(now, last)
        if self.gyr_end.is_reached(now.gyr_rad_s, step_s):
            why = Reason.GYROSCOPE_SATURATED
        if self.acc_end.is_reached(now.acc_m_s2, step_s):
            why = Reason.ACCELEROMETER_SATURATED
        if why is None:
            why = self.stuck.refusal(now, last)
        if why is None and self.gyr_end.is_large and self._is_spike(now):
            why = Reason.GYROSCOPE_SPIKE
        self.last = now
        if why is None:
            self.good = now
            span_us = now.raw_us - self.blinding_us
            if self.blinding is not None and not 0 <= span_us < BLIND_US:  # or began anew
                self.blinded = self.blinding, MICROSECOND * max(span_us, 0)
            self.blinding = None
        elif self.blinding is None and why in BLINDING:
            self.blinding, self.blinding_us = why, now.raw_us
        return why

    def take_blindness(self) -> tuple[Reason, float] | None:
        """Why, and for how many s, if this reading ended a stretch that hides a rotation; once."""
        blinded, self.blinded = self.blinded, None
        return blinded

    def _is_spike(self, now: Readings) -> bool:
        """Whether the rate leapt away from the last good one, and the reading before did not."""
        if not (self.gyr_end.is_noisy and self.acc_end.is_noisy):
            return False
        elapsed_s = MICROSECOND * max(now.raw_us - self.good.raw_us, 0)
        limit = max(RATE_STEP_RAD_S, RATE_STEP_RAD_S2 * elapsed_s)
        if largest(subtract(now.gyr_rad_s, self.good.gyr_rad_s)) <= limit:
            return False
        off = subtract(now.gyr_rad_s, self.last.gyr_rad_s)
        # an axis that agrees to the last digit is at the end of its range, and confirms nothing
        return largest(off) > limit or 0.0 in off


def largest(v: Vec3) -> float:
    """The largest part of a vector, without its sign."""
    return max(abs(v[0]), abs(v[1]), abs(v[2]))


def apart_rad(one: Vec3, other: Vec3) -> float:
    """The angle between two directions; 0 if one is none."""
    return 0.0 if ZERO_VEC3 in (one, other) else angle_between_vectors(one, other)


def carries_weight(acc_m_s2: Vec3, gyr_rad_s: Vec3) -> bool:
    """Whether the force is that of a turn that may go on for ever, as it is and at that rate.

    In the mean over the turn its part along the axis is left, and must hold the vehicle up.
    """
    rate_rad_s = norm(gyr_rad_s)
    if rate_rad_s == 0.0:
        return False
    along = dot(acc_m_s2, gyr_rad_s) / rate_rad_s
    return abs(abs(along) - G) <= WEIGHT_M_S2


def vector_after_turn(vector: Vec3, gyr_rad_s: Vec3, span_s: float) -> Vec3:
    """A body vector of something fixed, after turning at that rate."""
    return rotate_inverse(exp(scale(span_s, gyr_rad_s)), vector)
