"""Sensors that repeat themselves although the vehicle moves.

Real sensors are noisy: equal readings, one after the other, come from a driver that has stopped
reading. But fields are coarse, and simulators know rest without noise: so equal readings are
refused only if what the other sensors say cannot be true beside them.
"""

from dataclasses import dataclass, field
from math import pi

from drivers.samples.readings import STUCK_SAMPLES, STUCK_US, Readings, Repetition
from drivers.samples.steady_turn import (
    apart_rad,
    carries_weight,
    field_contradicts,
    largest,
    vector_after_turn,
)
from estimator.geometry.quaternion import norm
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

NOTHING = Readings(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
MICROSECOND = 1e-6
HELD_US = 2_000_000  # unlikely readings at most; by then it is known whether it is stuck
FROZEN_US = 300_000  # so long a moving gyroscope does not repeat itself while others do not
# Where there is no field, a steady turn explains equal readings for so long; noise ends it earlier
STEADY_US = 3_000_000
# One sensor alone is stuck once the others say that the vehicle has turned this far, in radians
STUCK_ACC_RAD = 0.35  # of what the gyroscope says; below MOVING_GYR it may be its bias
STUCK_GYR_RAD = 0.17  # of both the accelerometer and the magnetometer
STUCK_GYR_ALONE_RAD = 0.5  # of one of them, where the other cannot tell: no braking does that
LONGEST_STEP_S = 0.1
# What no vehicle at rest shows: more than a gyroscope's bias, not 1 g, force or field that turn
MOVING_GYR_RAD_S = 0.05
MOVING_ACC_M_S2 = 0.5
MOVING_RAD = 0.1
TOLD_RAD = 0.05  # a turn so far is told from noise


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
        if acc_equal:
            self._turn_force(now, step_us)
        return self._judge(now, raw_us)

    def _judge(self, now: Readings, raw_us: int) -> Reason | None:
        both, gyr, acc = self.both, self.gyr, self.acc
        if both.is_long(raw_us) and self._repeats_untruly(now, raw_us):
            both.is_proven = True
        if acc.is_long(raw_us) and apart_rad(self.turned, now.acc_m_s2) > STUCK_ACC_RAD:
            acc.is_proven = True
        if gyr.is_long(raw_us) and self._has_turned_otherwise(now, raw_us):
            gyr.is_proven = True
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

    def _turn_force(self, now: Readings, step_us: int) -> None:
        """Turn the repeated specific force as the gyroscope says (dv/dt = v x w).

        In a steady turn it stays as it is.
        """
        gyr, acc, _ = now
        if largest(gyr) > MOVING_GYR_RAD_S and not carries_weight(acc, gyr):
            step_s = min(max(MICROSECOND * step_us, 0.0), LONGEST_STEP_S)
            self.turned = vector_after_turn(self.turned, gyr, step_s)

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
        """Whether the field of a reading is not where the repeated rate has turned it."""
        span_s = MICROSECOND * max(raw_us - self.field_us, 0)  # the clock may have begun anew
        contradicts, is_far = field_contradicts(
            self.field_gauss, now.mag_gauss, now.gyr_rad_s, span_s
        )
        if is_far and not contradicts:
            self.field_gauss, self.field_us = now.mag_gauss, raw_us
        return contradicts

    def _has_turned_otherwise(self, now: Readings, raw_us: int) -> bool:
        """Whether accelerometer and field are not where the repeated rate would have them."""
        gyr, acc, mag = now
        span_s = MICROSECOND * (raw_us - self.gyr.begin_us)
        begin = self.gyr_begin
        acc_rad = apart_rad(vector_after_turn(begin.acc_m_s2, gyr, span_s), acc)
        is_steady = carries_weight(begin.acc_m_s2, gyr)  # then the force stays as it is
        if is_steady:
            acc_rad = min(acc_rad, apart_rad(begin.acc_m_s2, acc))
        if ZERO_VEC3 in (mag, begin.mag_gauss):
            return acc_rad > STUCK_GYR_ALONE_RAD
        mag_rad = apart_rad(vector_after_turn(begin.mag_gauss, gyr, span_s), mag)
        if is_steady and mag_rad > STUCK_GYR_ALONE_RAD:
            return True  # one steady turn feels like another
        return min(acc_rad, mag_rad) > STUCK_GYR_RAD

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
            if way_rad >= TOLD_RAD and apart_rad(expected, after) < 0.5 * way_rad:
                return False  # it has turned as the gyroscope says
        if largest(gyr) > MOVING_GYR_RAD_S:
            return True
        return max(apart_rad(begin.acc_m_s2, acc), apart_rad(*mags)) > MOVING_RAD
