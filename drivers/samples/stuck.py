"""Sensors that repeat themselves although the vehicle moves.

Real sensors are noisy: equal readings, one after the other, come from a driver that has stopped
reading. But fields are coarse, and simulators know rest without noise: so equal readings are
refused only if what the other sensors say cannot be true beside them.
"""

from dataclasses import dataclass, field
from math import log, pi
from typing import NamedTuple

from estimator.geometry.quaternion import (
    angle_between_vectors,
    dot,
    exp,
    norm,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

MICROSECOND = 1e-6
HELD_US = 2_000_000  # unlikely readings at most; by then it is known whether it is stuck
FROZEN_US = 300_000  # so long a moving gyroscope does not repeat itself while others do not
# Where there is no field, a steady turn explains equal readings for so long; noise ends it earlier
STEADY_US = 3_000_000
# An accelerometer alone is stuck once the gyroscope says that the vehicle has turned this far, in
# radians; below MOVING_GYR_RAD_S that may be its bias
STUCK_ACC_RAD = 0.35
LONGEST_STEP_S = 0.1
# What no vehicle at rest shows: more than a gyroscope's bias, not 1 g, force or field that turn
MOVING_GYR_RAD_S = 0.05
MOVING_ACC_M_S2 = 0.5
MOVING_RAD = 0.1
TOLD_RAD = 0.05  # a turn so far is told from noise
CONFIRMS_RAD = 0.25  # nearer than that to where the rate says, and half the way: it has turned so
NOISY_SAMPLES = 50  # that many changes before prove that a sensor has noise
STUCK_SAMPLES = 20  # equal readings
STUCK_US = 500_000
SHARE_CHANGES = 200  # the share of equal readings goes back over so many changes
# Equal readings are unlikely where chance would bring so many in a row less than once in 1e8
# times. So rarely, since a smooth motion in coarse digits repeats itself more often than chance.
BY_CHANCE = 1e-8
HELD_SAMPLES = 3  # at least
WEIGHT_M_S2 = 0.5  # from 1 g, of the force along the axis of a steady turn
FIELD_OFF = 0.17  # of the field's strength, that it may be elsewhere than the rate says
FIELD_OFF_SHARE = 0.5  # or so much of the way that the rate says: hard iron bends it
FIELD_LATE_S = 0.15  # magnetometers follow 0.1 s late, in steps
FIELD_WAY = 0.5  # of the field's strength: having gone so far as the rate says, it begins anew
MAG_STUCK_US = 2_000_000
MAG_TURN_RAD = 0.5  # turned so far, the field cannot be what it was


class Readings(NamedTuple):
    """One IMU message's vectors."""

    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


NOTHING = Readings(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)


@dataclass(slots=True)
class Repetition:
    """Counts a sensor's equal readings, and knows how often it repeats itself.

    ``is_proven`` is for whoever finds that what is repeated cannot be true; the next change of the
    reading takes it back.
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
class StuckImu:
    """Finds gyroscope and accelerometer repeating what cannot be true."""

    both: Repetition = field(default_factory=Repetition)
    gyr: Repetition = field(default_factory=Repetition)
    acc: Repetition = field(default_factory=Repetition)
    last_us: int = 0
    field_gauss: Vec3 = ZERO_VEC3  # at its first look since both repeat themselves
    field_us: int = 0
    gyr_begin: Readings = NOTHING  # when the gyroscope began to repeat itself
    turned: Vec3 = ZERO_VEC3  # where the gyroscope says that the repeated force should be

    def refusal(self, now: Readings, last: Readings, raw_us: int) -> Reason | None:
        """Why the reading behind ``last`` cannot be true."""
        gyr, acc, mag = now
        gyr_equal, acc_equal = gyr == last.gyr_rad_s, acc == last.acc_m_s2
        self.both.observe(raw_us, repeats=gyr_equal and acc_equal)
        self.gyr.observe(raw_us, repeats=gyr_equal)
        self.acc.observe(raw_us, repeats=acc_equal)
        step_us, self.last_us = raw_us - self.last_us, raw_us
        if not acc_equal:
            self.turned = acc
        if not gyr_equal:
            self.gyr_begin = now
        if not (gyr_equal and acc_equal):
            self.field_gauss, self.field_us = mag, raw_us
            if not (gyr_equal or acc_equal):  # nearly always
                return None
        if acc_equal and largest(gyr) > MOVING_GYR_RAD_S and not carries_weight(acc, gyr):
            # the repeated force turns as the gyroscope says (dv/dt = v x w), but in a steady turn
            step_s = min(max(MICROSECOND * step_us, 0.0), LONGEST_STEP_S)
            self.turned = vector_after_turn(self.turned, gyr, step_s)
        return self._judge(now, raw_us)

    def _judge(self, now: Readings, raw_us: int) -> Reason | None:
        both, gyr, acc = self.both, self.gyr, self.acc
        if both.is_long(raw_us) and self._repeats_untruly(now, raw_us):
            both.is_proven = True
        if acc.is_long(raw_us) and apart_rad(self.turned, now.acc_m_s2) > STUCK_ACC_RAD:
            acc.is_proven = True
        is_unlikely = gyr.is_unlikely()
        if is_unlikely and self._is_frozen(now, raw_us):
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

    def _repeats_untruly(self, now: Readings, raw_us: int) -> bool:
        """Whether what gyroscope and accelerometer repeat cannot be true."""
        gyr, acc, mag = now
        knows_field = ZERO_VEC3 not in (mag, self.field_gauss)
        if largest(gyr) <= MOVING_GYR_RAD_S:
            is_heavier = abs(norm(acc) - STANDARD_GRAVITY_M_S2) > MOVING_ACC_M_S2
            return is_heavier or (knows_field and self._field_contradicts(now, raw_us))
        if not carries_weight(acc, gyr):
            return True
        if knows_field:
            return self._field_contradicts(now, raw_us)
        return raw_us - self.both.begin_us >= STEADY_US

    def _field_contradicts(self, now: Readings, raw_us: int) -> bool:
        """Whether the field of a reading is not where the repeated rate has turned it.

        Well on its way it is watched from here on.
        """
        before, gyr = self.field_gauss, now.gyr_rad_s
        span_s = MICROSECOND * max(raw_us - self.field_us, 0)  # the clock may have begun anew
        expected = vector_after_turn(before, gyr, span_s)
        way = norm(subtract(expected, before)) / norm(before)
        off = norm(subtract(expected, now.mag_gauss)) / norm(before)
        contradicts = off > max(FIELD_OFF + FIELD_LATE_S * norm(gyr), FIELD_OFF_SHARE * way)
        if way >= FIELD_WAY and not contradicts:
            self.field_gauss, self.field_us = now.mag_gauss, raw_us
        return contradicts

    def _is_frozen(self, now: Readings, raw_us: int) -> bool:
        """Whether the gyroscope alone has stopped, in a vehicle that moves otherwise."""
        span_us = raw_us - self.gyr.begin_us
        if span_us < FROZEN_US or 2 * self.acc.equal > self.gyr.equal:
            return False
        gyr, acc, mag = now
        begin, span_s = self.gyr_begin, MICROSECOND * span_us
        half_s = min(span_s, pi / max(norm(gyr), 1e-9))  # of a turn: no way is longer
        mags = (begin.mag_gauss, mag)
        for before, after in ((begin.acc_m_s2, acc), mags):
            expected = vector_after_turn(before, gyr, span_s)
            way_rad = apart_rad(before, vector_after_turn(before, gyr, half_s))
            near_rad = min(0.5 * way_rad, CONFIRMS_RAD)
            if way_rad >= TOLD_RAD and apart_rad(expected, after) < near_rad:
                return False  # it has turned as the gyroscope says
        if largest(gyr) > MOVING_GYR_RAD_S:
            return True
        return max(apart_rad(begin.acc_m_s2, acc), apart_rad(*mags)) > MOVING_RAD


@dataclass(slots=True)
class StuckField:
    """Finds a field that does not follow the vehicle's turning."""

    mag: Repetition = field(default_factory=Repetition)
    turn_rad: float = 0.0  # without a new field

    def observe(self, now: Readings, last: Readings, raw_us: int, step_us: int) -> None:
        """Take the reading behind ``last``."""
        mag, field_gauss = self.mag, now.mag_gauss
        repeats = field_gauss == last.mag_gauss and field_gauss != ZERO_VEC3
        mag.observe(raw_us, repeats=repeats)
        if not repeats:
            self.turn_rad = 0.0
            return
        step_s = MICROSECOND * min(max(step_us, 0), MAG_STUCK_US)
        self.turn_rad += step_s * largest(now.gyr_rad_s)
        if self.turn_rad >= MAG_TURN_RAD and mag.is_long(raw_us, MAG_STUCK_US):
            mag.is_proven = True


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
    return abs(abs(along) - STANDARD_GRAVITY_M_S2) <= WEIGHT_M_S2


def vector_after_turn(vector: Vec3, gyr_rad_s: Vec3, span_s: float) -> Vec3:
    """A body vector of something fixed, after turning at that rate."""
    return rotate_inverse(exp(scale(span_s, gyr_rad_s)), vector)
