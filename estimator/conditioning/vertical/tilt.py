"""How well the vertical is known in G, and how fast it follows the specific force.

Between two samples of a slow stream the gyroscope is aliased. So the vertical has a variance: each
step's unseen turning adds to it, and each reading of the specific force takes from it. Their
balance is the share by which the vertical follows the force. Its root is the published uncertainty
of slow streams.
"""

from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import (
    ACCELERATION_LASTS_S,
    QUICK_S,
    SPAN_S,
    USUAL_S,
    ConditioningParams,
)
from estimator.conditioning.rate import MOST_ERROR, is_mean, likeness, slow_share
from estimator.conditioning.vertical.slow_acceleration import apart_rad
from estimator.geometry.quaternion import ANY_DIRECTION_VARIANCE, dot, norm, scale, subtract
from estimator.types import ZERO_VEC3, Between, Vec2, Vec3

# White noise of a gyroscope and its truncation to mrad/s, rad/s/sqrt(Hz).
GYR_NOISE = 0.002
# After a hole longer than SPAN_S a vehicle may have done anything, at this rate (rad/s).
HOLE_RAD_S = 0.3
# Least error (rad), half a degree, of a second's mean force at rest, of the first vectors and of a
# model's declination; that of one reading is twice as large.
LEAST_OFF_RAD = 0.009


class TiltState(NamedTuple):
    """How well the vertical is known in G."""

    variance: float = ANY_DIRECTION_VARIANCE  # of its direction, rad^2
    fresh: float = ANY_DIRECTION_VARIANCE  # the same if no acceleration lasted, rad^2
    scatter: float = 0.0  # mean square angle of the specific force about it, rad^2
    tilting: float = 0.0  # mean square of what the rate does off its line about horizontal axes
    yawing: float = 0.0  # the same about down, (rad/s)^2
    gyr: Vec3 = ZERO_VEC3  # mean rate of the last step, rad/s, FRD
    change: Vec3 = ZERO_VEC3  # by which it differed from that of the step before
    changed: float = 0.0  # mean square of that
    force: float = 0.0  # mean size of the specific force, m/s^2
    drift: float = 0.0  # covariance of its error and the gyroscope's bias about an axis, rad^2/s
    aliasing: float = 0.0  # variance of the turn about both horizontal axes the last step missed


@inlined
def slowness(params: ConditioningParams, dt_s: float) -> float:
    """0 for fast streams and for averages, which miss no turn; 1 for slow ones."""
    if params.averaged_samples or not params.use_step_noise:
        return 0.0
    return slow_share(dt_s)


@inlined
def weighing(params: ConditioningParams, dt_s: float) -> float:
    """1 if the vertical's own variance weighs the force, 0 if averaging does.

    It does so for slow streams and in vehicles: their accelerations outlast any average, and an
    autopilot's gyroscope bridges them. For a hand's short accelerations the average is better.
    """
    return 1.0 if params.in_vehicle else slowness(params, dt_s)


@inlined
def step_noise(
    params: ConditioningParams,
    state: TiltState,
    mean: Gathered,
    rate: Vec3,
    down: Vec3,
    before_s: float,
    between: Between,
) -> tuple[TiltState, float]:
    """The state with what a step has missed about horizontal axes, and the variance about down.

    Both variances are in rad^2. The mean of two independent readings is off that over the step by
    q = dt^2 |w''|^2 / 12, with w'' by which the last one lies off the line through the two before.
    A random walk of the rate leaves half of that, a motion that the samples show next to nothing:
    L^2 of that, with L = |w''|^2 / (3 |dw|^2), by the changes dw from reading to reading. With
    other readings within the step, a time s apart, the rate walks between those: q = dt s |dw|^2 /
    12. Added to that are (a s^2 |w|)^2 dt/s, and 4 C dt for both axes by a gyroscope bias of the
    variance b^2, (rad/s)^2 about an axis: C <- C + b^2 dt (done already in ``state``).
    """
    dt_s, change = mean.time_s, subtract(mean.gyr, state.gyr)
    changed, seen_s = dot(change, change), dt_s
    if between.given:
        seen_s = between.step_s
        off, factor = between.change_rad_s, dt_s * seen_s / 12.0
    else:
        off = subtract(change, scale(min(1.0, dt_s / max(before_s, TINY)), state.change))
        # one small difference may be chance, so the mean over the last seconds is the least
        usual = (state.tilting + state.yawing) / (1.0 + 2.0 * MOST_ERROR)
        like = likeness(max(dot(off, off), usual), max(changed, state.changed))
        factor = like * like * dt_s * dt_s / 12.0
    along, all_of_it = dot(off, down) ** 2, dot(off, off)
    tilting = max(0.0, all_of_it - along) + MOST_ERROR * all_of_it
    yawing = along + MOST_ERROR * all_of_it
    about_down = dot(rate, down) ** 2
    turning = dot(rate, rate)
    if is_mean(dt_s, params.averaged_samples):
        factor *= MOST_ERROR**2
    turn_factor = dt_s / seen_s * (params.step_turn_noise_1_s * seen_s * seen_s) ** 2
    tilt = factor * max(tilting, state.tilting)
    yaw_noise = factor * max(yawing, state.yawing)
    tilt += turn_factor * (max(0.0, turning - about_down) + MOST_ERROR * turning)
    yaw_noise += turn_factor * (about_down + MOST_ERROR * turning)
    hole = HOLE_RAD_S**2 * max(0.0, dt_s - SPAN_S) ** 2
    c = dt_s / (ACCELERATION_LASTS_S + dt_s)
    state = state._replace(
        tilting=state.tilting + c * (tilting - state.tilting),
        yawing=state.yawing + c * (yawing - state.yawing),
        gyr=mean.gyr,
        change=change,
        changed=state.changed + c * (changed - state.changed),
        aliasing=tilt + GYR_NOISE**2 * dt_s + 4.0 * state.drift * dt_s + hole,
    )
    return state, yaw_noise + GYR_NOISE**2 * dt_s + hole


@inlined
def update_tilt(
    params: ConditioningParams,
    state: TiltState,
    down_g: Vec3,
    u: Vec3,
    dt_s: float,
    slow_square: float,
    least_share: float,
) -> tuple[TiltState, float]:
    """The variance after a step with the force ``u`` (minus it, in G), and the force's share.

    A scalar Kalman filter, whose P has grown by the step: K = P/(P + R), P <- (1 - K)^2 P + K^2 R.
    R = r 2 T/dt, as accelerations last for T. r is the scatter of the force's direction plus the
    square of the share by which its size is unusual. The scatter is learnt from the innovations v
    by expectation, (r/(P + r))^2 v^2 + P r/(P + r). Longer accelerations add ``slow_square``
    (rad^2). The share is at least ``least_share``.
    """
    p, mean, size = state.variance, state.force, norm(u)
    unusual = size / mean - 1.0 if mean > 0.0 else 0.0
    r = state.scatter + unusual**2
    brief = r * max(1.0, 2.0 * QUICK_S / dt_s)
    white = brief + slow_square * max(1.0, 2.0 * ACCELERATION_LASTS_S / dt_s)
    share = max(least_share, p / (p + white))
    off = apart_rad(down_g, u)
    of_force = r / (p + r)
    expected = (of_force * off) ** 2 + p * of_force
    a = dt_s / (params.scatter_tau_s + dt_s)
    b = dt_s / (USUAL_S + dt_s) if abs(unusual) < 0.2 else 0.1 * dt_s / (USUAL_S + dt_s)
    state = state._replace(
        variance=(1.0 - share) ** 2 * p + share * share * white,
        fresh=p * brief / (p + brief),
        scatter=state.scatter + a * (max(expected, 4.0 * LEAST_OFF_RAD**2) - state.scatter),
        force=mean + b * (size - mean),
        drift=(1.0 - share) * state.drift,
    )
    return state, share


@inlined
def force_after_turn(
    inflation: float, force_scatter: float, dt_s: float, least_share: float
) -> Vec2:
    """The inflation that a reading of the force leaves, and a Kalman filter's share of it.

    ``inflation`` (rad^2) is the variance that an unsensed turn has given the vertical,
    ``force_scatter`` how far the mean of ``SPAN_S`` usually is off, so that a reading's noise is
    force_scatter 2 tau/dt. Once the low-pass is as quick, by ``least_share``, both are zero.
    """
    noise = (force_scatter + LEAST_OFF_RAD**2) * 2.0 * SPAN_S / dt_s
    share = inflation / (inflation + noise)
    if share <= least_share:
        return 0.0, 0.0
    return (1.0 - share) * inflation, share
