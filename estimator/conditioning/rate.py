"""The angular rate that integrates best over one step, and what a gyroscope at its end misses.

A reading that stands still at its largest value hides a faster turn.
"""

from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import LONGEST_STEP_S
from estimator.geometry.quaternion import add, cross, exp, log, multiply, scale, subtract
from estimator.types import ZERO_VEC3, Vec2, Vec3

# Largest error of a gyroscope as a share of a turn (cheap ones: 5 to 10 %), of what it shows about
# other axes, of what averages over a step miss (coning), and of a rate beyond its end. Small: late,
# large: accelerations tilt the vertical.
MOST_ERROR = 0.1
# Plain samples closer than this (s) count as means over the step before them: little happens
# between them, and averaging two noisy instants is worse.
SLOW_SAMPLE_S = 0.0125
# Up to this step (s) a gyroscope misses nothing that matters. "Slow" streams have longer steps; at
# LONGEST_STEP_S it may miss anything.
FAST_STEP_S = 0.04


@inlined
def is_mean(dt_s: float, averaged: bool) -> bool:
    """Whether a sample counts as the mean over the step before it, not as an instant."""
    return averaged or dt_s < SLOW_SAMPLE_S


@inlined
def integration_rate(previous: Vec3, gyr: Vec3, dt_s: float, averaged: bool) -> Vec3:
    """Rate whose exponential is the turn over the step, to second order.

    If the axis moves, the turn is not the integral of the rate (coning). With the rate linear in
    time the first correction of Magnus' series is dt/12 (w_previous x w), for the mean rate over
    the step. Plain samples are instants, with the mean (w_previous + w)/2. Source: A. Iserles and
    S. P. Norsett 1999, doi 10.1098/rsta.1999.0362.
    """
    cone = cross(previous, gyr)
    k = dt_s / 12.0
    if is_mean(dt_s, averaged):
        return add(gyr, scale(k, cone))
    return add(scale(0.5, add(previous, gyr)), scale(k, cone))


@inlined
def corrected_rate(rate: Vec3, correction: Vec3, share: float, dt_s: float) -> Vec3:
    """The rate w' of a step that is turned by w and then by a share of a correction phi (rad).

    exp(w' dt) = exp(w dt) exp(share phi), all in the body's axes.
    """
    turn = multiply(exp(scale(dt_s, rate)), exp(scale(share, correction)))
    return scale(1.0 / dt_s, log(turn))


@inlined
def slow_share(dt_s: float) -> float:
    """0 for the steps of fast streams, 1 for those of slow ones."""
    return max(0.0, min(1.0, (dt_s - FAST_STEP_S) / (LONGEST_STEP_S - FAST_STEP_S)))


@inlined
def likeness(second_difference: float, changed: float) -> float:
    """How far readings look as if they were independent, by squared differences: 0 to 1.

    The second differences' mean square is then three times that of the first ones.
    """
    return min(1.0, second_difference / (3.0 * changed + TINY))


@inlined
def at_interval_end(v: Vec3, gyr: Vec3, dt_s: float) -> Vec3:
    """A vector averaged over the step, turned to the attitude at its end: v - (w x v) dt/2.

    A mean rate carries the attitude to the end of the step, whatever delay both sensors have in
    common: half a step beyond the accelerometer's reading.
    """
    return subtract(v, scale(0.5 * dt_s, cross(gyr, v)))


# Slower readings (rad/s) are at no sensor's end: 115 deg/s.
LEAST_PEAK_RAD_S = 2.0


class Clipping(NamedTuple):
    """The gyroscope's end, and what it has missed there; one number for each axis, FRD."""

    peak_rad_s: Vec3 = ZERO_VEC3  # largest reading so far, either way
    run_s: Vec3 = ZERO_VEC3  # for how long the axis has stood at its peak
    aliasing: Vec3 = ZERO_VEC3  # variance of the turn missed since the last learning step, rad^2


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
