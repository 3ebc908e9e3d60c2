"""A gyroscope at its end: a reading that stands still at its largest value hides a faster turn."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.vertical.averaging import MOST_ERROR
from estimator.types import ZERO_VEC3, Vec2, Vec3

# Slower readings (rad/s) are at no sensor's end: 115 deg/s.
LEAST_PEAK_RAD_S = 2.0


class Clipping(NamedTuple):
    """Where the gyroscope ends, and what it has missed there; one number for each axis, FRD."""

    peak_rad_s: Vec3 = ZERO_VEC3  # largest reading so far, either way
    run_s: Vec3 = ZERO_VEC3  # for how long the axis has stood at its peak
    aliasing: Vec3 = ZERO_VEC3  # variance of the turn missed since the last learning step, rad^2


with_aliasing = replacer(Clipping, "aliasing")


@inlined
def watch_axis(
    peak: float, run_s: float, aliasing: float, previous: float, now: float, dt_s: float
) -> tuple[float, float, float]:
    """The peak, the time at it and the variance missed of one axis.

    Only a sensor at its end repeats its largest reading to the last digit. The rate beyond it is
    taken as constant for that run, so the turn missed has the variance (beyond T)^2: a peak that
    rounding repeats once or twice costs next to nothing.
    """
    at_peak = abs(now) >= max(peak, LEAST_PEAK_RAD_S) and now == previous
    peak = max(peak, abs(now))
    if not at_peak:
        return peak, 0.0, aliasing
    beyond = MOST_ERROR * peak
    return peak, run_s + dt_s, aliasing + beyond * beyond * (2.0 * run_s + dt_s) * dt_s


@inlined
def watch_clipping(state: Clipping, previous: Vec3, gyr: Vec3, dt_s: float) -> Clipping:
    """The state after a reading ``gyr`` (rad/s, FRD), ``dt_s`` after the ``previous`` one."""
    p, r, m = state.peak_rad_s, state.run_s, state.aliasing
    p0, r0, m0 = watch_axis(p[0], r[0], m[0], previous[0], gyr[0], dt_s)
    p1, r1, m1 = watch_axis(p[1], r[1], m[1], previous[1], gyr[1], dt_s)
    p2, r2, m2 = watch_axis(p[2], r[2], m[2], previous[2], gyr[2], dt_s)
    return Clipping((p0, p1, p2), (r0, r1, r2), (m0, m1, m2))


@inlined
def aliased_turn(state: Clipping, down: Vec3) -> Vec2:
    """Variance (rad^2) of the turn missed: about horizontal axes, both together, and about down."""
    m = state.aliasing
    about = m[0] * down[0] ** 2 + m[1] * down[1] ** 2 + m[2] * down[2] ** 2
    return max(0.0, m[0] + m[1] + m[2] - about), about
