"""Low-frequency accelerations of a slow stream, which last too long to be averaged out.

A vehicle that turns, climbs or brakes for seconds draws the force of a second away from its own
long mean in G. G drifts as well if the gyroscope misses turns, by as much as the steps' noise; the
rest is an acceleration. The size of the force, the root of g^2 + a^2 for a horizontal acceleration
a, limits it; a rest shows how large the sensor reads g. No vehicle accelerates up or down for long,
so along the vertical the mean force is gravity: if it is less, the vertical is wrong by an angle of
that cosine.

A vehicle that is shaken faster than it is sampled turns by any angle between two samples and stays
about where it was. Then the mean force, seen from the body, shows its tilt better than the latest
one. Tilting and shaking both scatter the force's direction; shaking also scatters its size, along
gravity as much as about either axis across it.
"""

from math import sqrt
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import LATELY_S, LONG_S, USUAL_S
from estimator.conditioning.vertical.lowpass import approach
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.geometry.quaternion import (
    ANY_DIRECTION_VARIANCE,
    angle_between_vectors,
    dot,
    norm,
    scale,
    square,
)
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

# Before anything is seen they turn the force by as much (rad^2).
PRIOR_VARIANCE = 0.02
# By so much a sensor's scale may be off, as a share, and what it measures with it.
SCALE_ERROR = 0.03
# Largest angle of the force that counts as scatter, rad; beyond it is an unsensed turn.
MOST_APART_RAD = 1.0


class SlowAcceleration(NamedTuple):
    """What shows accelerations that last; mean squares over ``USUAL_S``."""

    apart: float = PRIOR_VARIANCE  # angle between the force of a second and its long mean, rad^2
    lag: float = 0.0  # variance of the long mean by the drift of G, now, rad^2
    drift: float = 0.0  # and its mean, rad^2
    excess: float = 0.0  # by which the force's square exceeds that of gravity, as a share of it
    excess_variance: float = 0.0  # of that, by shaking
    long: Vec3 = ZERO_VEC3  # long mean of the force (minus it, in G), m/s^2
    along: float = 1.0  # mean force along the vertical over ``LATELY_S``, as a share of gravity
    size: float = 1.0  # of the last force, as a share of gravity
    seen_s: float = 0.0  # for how long the vehicle has been watched
    gravity: float = 1.0  # as the sensor measures it at rest, as a share of the standard one
    rested_s: float = 0.0  # what that is the mean of


@inlined
def apart_rad(u: Vec3, v: Vec3) -> float:
    """Angle between two vectors, at most ``MOST_APART_RAD``, as where one has no direction."""
    if square(u) * square(v) <= 0.0:
        return MOST_APART_RAD
    return min(angle_between_vectors(u, v), MOST_APART_RAD)


@inlined
def slow_variance(state: SlowAcceleration) -> float:
    """Variance (rad^2, both axes together) of the force's direction by such accelerations."""
    # a rest leaves little of the sensor's error, twice of which is the square's; two sigmas of the
    # mean are rarely chance
    error = LEAST_DIRECTION_RAD if state.rested_s > 0.0 else SCALE_ERROR
    least = min(state.apart, state.excess - 2.0 * (error + sqrt(state.excess_variance)))
    most = max(0.0, state.excess + 2.0 * SCALE_ERROR)
    return max(0.0, least, min(state.apart - state.drift, most))


@inlined
def watch_rest(state: SlowAcceleration, u: Vec3, dt_s: float) -> SlowAcceleration:
    """A step at rest with the force ``u``: it shows gravity, and nothing of accelerations.

    A force that is off by more than ``SCALE_ERROR`` is none of gravity alone.
    """
    rested_s = min(state.rested_s + dt_s, LATELY_S)
    size = norm(u) / STANDARD_GRAVITY_M_S2
    limited = max(1.0 - SCALE_ERROR, min(1.0 + SCALE_ERROR, size))
    gravity = state.gravity + dt_s / rested_s * (limited - state.gravity)
    return state._replace(seen_s=state.seen_s + dt_s, gravity=gravity, rested_s=rested_s)


@inlined
def watch_slow(
    state: SlowAcceleration,
    u: Vec3,
    quick: Vec3,
    down_g: Vec3,
    long_share: float,
    aliasing: float,
    carried: float,
    dt_s: float,
) -> SlowAcceleration:
    """A step with the force ``u``, of which ``quick`` is the mean over a second (minus it, in G).

    ``down_g`` is the vertical before it. The long mean moves by ``long_share`` a step, so it lags
    behind a turn of the variance ``aliasing`` (rad^2) in each step by L <- (1 - share)^2 (L +
    missed). Until the vehicle has been watched for ``USUAL_S`` that mean may itself lie off as far
    as the size of the force allows, of which the share ``carried`` counts.
    """
    long = approach(state.long, u, long_share)
    lag = (1.0 - long_share) ** 2 * (state.lag + aliasing)
    off = apart_rad(quick, long) ** 2
    size = norm(u) / (state.gravity * STANDARD_GRAVITY_M_S2)
    # half of the mean square of such changes is what shakes along the force; across it is the same
    shaken = 3.0 * 0.5 * (size - state.size) ** 2
    excess = size * size - 1.0 - shaken
    along = dot(u, down_g) / (norm(down_g) * STANDARD_GRAVITY_M_S2) if square(down_g) > 0.0 else 1.0
    b = dt_s / (USUAL_S + dt_s)
    seen_s = state.seen_s + dt_s
    age_s = seen_s / max(carried, TINY)
    excess = state.excess + max(b, dt_s / age_s) * (excess - state.excess)
    unseen = max(0.0, 1.0 - age_s / USUAL_S)
    # of a mean over ``USUAL_S`` of squares that scatter by 4/3 of what shakes
    variance = 2.0 / 3.0 * b * shaken
    return state._replace(
        apart=max(state.apart + b * (off - state.apart), unseen * min(excess, MOST_APART_RAD**2)),
        lag=lag,
        drift=state.drift + b * (lag - state.drift),
        excess=excess,
        excess_variance=state.excess_variance + b * (variance - state.excess_variance),
        long=long,
        along=state.along + dt_s / (LATELY_S + dt_s) * (along - state.along),
        size=size,
        seen_s=seen_s,
    )


class LostSteps(NamedTuple):
    """Statistics of the steps that have lost the vertical, each weighted by how far."""

    down: Vec3 = ZERO_VEC3  # minus the mean force of ``LATELY_S``, m/s^2, FRD
    seen_s: float = 0.0  # what that is the mean of
    steps: float = 0.0  # over ``LONG_S``
    proofs: float = 0.0  # of these, by how far the force's direction has scattered, too
    tilted: float = 0.0  # sum of squares of angles (rad^2) by which a tilt has turned the force
    shaken: float = 0.0  # and shaking


@inlined
def add_lost_step(known: LostSteps, force: Vec3, lost: float, dt_s: float) -> LostSteps:
    """Add a step's mean ``force`` (FRD); it has ``lost`` a share of the vertical, 0 to 1."""
    down, off = scale(-1.0, force), 0.0
    if square(known.down) * square(down) > 0.0:
        off = apart_rad(known.down, down) ** 2
    size = norm(force) / STANDARD_GRAVITY_M_S2 - 1.0
    shaken = 2.0 * size * size
    proof = lost * off / (off + shaken) if off > 0.0 else 0.0  # thrust changes only its size
    seen_s = min(known.seen_s + dt_s, LATELY_S)
    keep = LONG_S / (LONG_S + dt_s)
    return LostSteps(
        down=approach(known.down, down, dt_s / seen_s),
        seen_s=seen_s,
        steps=keep * known.steps + lost,
        proofs=keep * known.proofs + proof,
        tilted=keep * known.tilted + lost * (off - shaken),
        shaken=keep * known.shaken + lost * shaken,
    )


@inlined
def mean_tilt_variance(known: LostSteps, slow_square: float, dt_s: float) -> float:
    """Variance (rad^2) of the vertical about the mean one, which is unknown before any step.

    A tilt that shows as an acceleration in G, of the variance ``slow_square``, counts, too.
    """
    prior = ANY_DIRECTION_VARIANCE / (1.0 + known.proofs)
    tilted = prior + max(0.0, known.tilted) / (1.0 + known.steps) + slow_square
    shaken = known.shaken / (1.0 + known.steps)
    of_mean = (tilted + shaken) * min(1.0, dt_s / max(known.seen_s, dt_s))
    return min(tilted + of_mean, ANY_DIRECTION_VARIANCE)
