"""Accelerations of a slow stream that last too long to be averaged out, by what betrays them.

A vehicle that turns, climbs or brakes for seconds draws the force of a second away from its own
long mean in G. Frame G drifts as well where the gyroscope misses turns, by as much as the steps'
noise says; what is more than that the vehicle has accelerated. The size of the force, of gravity
and a horizontal acceleration a the root of g^2 + a^2, says how much that may have been at most, and
where G drifts too much to tell, at least. Shaking makes it larger, too, but otherwise from one
reading to the next.

For long no vehicle accelerates up or down, so along the vertical the mean force is gravity. If it
is less, the vertical is wrong, by an angle of that cosine.

How a vehicle is usually tilted helps where the gyroscope has shown nothing of a step. One that is
shaken faster than its samples come turns by any angle between two of them, and stays
about where it was. Then the mean force, seen from the body, shows its tilt better than the latest
force does. What leans scatters the force's direction, and so does what shakes, but that scatters
the force's size as well: along gravity by as much as about either axis across it.
"""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.times import LATELY_S, LONG_S, USUAL_S
from estimator.conditioning.vertical.lowpass import approach
from estimator.geometry.quaternion import angle_between_vectors, dot, norm, square
from estimator.geometry.spread import ANY_DIRECTION_VARIANCE
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

# Before anything is seen they turn the force by as much (rad^2).
PRIOR_VARIANCE = 0.02
# By so much a sensor's scale may be off, as a share, and what it measures with it.
SCALE_ERROR = 0.03
# An angle by which the force is off counts up to this, rad: what is further off is no scatter, but
# a turn that no sensor has felt, if it lasts.
MOST_APART_RAD = 1.0


class Lasting(NamedTuple):
    """What betrays accelerations that last; mean squares over ``USUAL_S``."""

    apart: float = PRIOR_VARIANCE  # angle between the force of a second and its long mean, rad^2
    lag: float = 0.0  # variance of the long mean by the drift of G, now, rad^2
    drift: float = 0.0  # and usually, rad^2
    excess: float = 0.0  # by which the force's square exceeds that of gravity, as a share of it
    long: Vec3 = ZERO_VEC3  # long mean of the force (minus it, in G), m/s^2
    along: float = 1.0  # mean force along the vertical over ``LATELY_S``, as a share of gravity
    size: float = 1.0  # of the last force, as a share of gravity


@inlined
def lasting_variance(state: Lasting) -> float:
    """Variance (rad^2, both axes together) of the force's direction by such accelerations."""
    least = min(state.apart, state.excess - 2.0 * SCALE_ERROR)
    most = max(0.0, state.excess + 2.0 * SCALE_ERROR)
    return max(0.0, least, min(state.apart - state.drift, most))


@inlined
def least_variance(state: Lasting) -> float:
    """The least variance (rad^2) of the vertical: t^2 = 2 (1 - cos t) of what shows it is wrong."""
    return max(0.0, 2.0 * (1.0 - state.along - SCALE_ERROR))


@inlined
def watch_lasting(
    state: Lasting,
    u: Vec3,
    quick: Vec3,
    down_g: Vec3,
    long_share: float,
    aliasing: float,
    dt_s: float,
) -> Lasting:
    """A step with the force ``u``, of which ``quick`` is the mean over a second (minus it, in G).

    ``down_g`` is where the vertical has been before it. The long mean moves by ``long_share`` a
    step, so of a turn of the variance ``aliasing`` (rad^2) in each step it lags behind by
    L <- (1 - share)^2 (L + missed).
    """
    long = approach(state.long, u, long_share)
    lag = (1.0 - long_share) ** 2 * (state.lag + aliasing)
    off = MOST_APART_RAD**2
    if square(quick) * square(long) > 0.0:
        off = min(angle_between_vectors(quick, long) ** 2, MOST_APART_RAD**2)
    size = norm(u) / STANDARD_GRAVITY_M_S2
    # half of the mean square of such changes is what shakes along the force; across it is the same
    shaken = 3.0 * 0.5 * (size - state.size) ** 2
    excess = size * size - 1.0 - shaken
    along = dot(u, down_g) / (norm(down_g) * STANDARD_GRAVITY_M_S2) if square(down_g) > 0.0 else 1.0
    b = dt_s / (USUAL_S + dt_s)
    return Lasting(
        apart=state.apart + b * (off - state.apart),
        lag=lag,
        drift=state.drift + b * (lag - state.drift),
        excess=state.excess + b * (excess - state.excess),
        long=long,
        along=state.along + dt_s / (LATELY_S + dt_s) * (along - state.along),
        size=size,
    )


class Usual(NamedTuple):
    """Of the steps that have lost the vertical; each counts by how far it has."""

    down: Vec3 = ZERO_VEC3  # minus the mean force of ``LATELY_S``, m/s^2, FRD
    seen_s: float = 0.0  # what that is the mean of
    steps: float = 0.0  # over ``LONG_S``
    proofs: float = 0.0  # of these, by how far the force's direction has scattered, too
    leant: float = 0.0  # sum of squares of angles (rad^2) by which leaning has turned the force
    shaken: float = 0.0  # and shaking


@inlined
def watch_usual(usual: Usual, force: Vec3, lost: float, dt_s: float) -> Usual:
    """With a step's mean ``force`` (FRD); the step has ``lost`` so much of the vertical, 0 to 1."""
    down = (-force[0], -force[1], -force[2])
    off = 0.0
    if square(usual.down) * square(down) > 0.0:
        off = min(angle_between_vectors(usual.down, down) ** 2, MOST_APART_RAD**2)
    size = norm(force) / STANDARD_GRAVITY_M_S2 - 1.0
    shaken = 2.0 * size * size
    proof = lost * off / (off + shaken) if off > 0.0 else 0.0  # thrust changes its size alone
    seen_s = min(usual.seen_s + dt_s, LATELY_S)
    keep = LONG_S / (LONG_S + dt_s)
    return Usual(
        down=approach(usual.down, down, dt_s / seen_s),
        seen_s=seen_s,
        steps=keep * usual.steps + lost,
        proofs=keep * usual.proofs + proof,
        leant=keep * usual.leant + lost * (off - shaken),
        shaken=keep * usual.shaken + lost * shaken,
    )


@inlined
def usual_variance(usual: Usual, lasting: float, dt_s: float) -> float:
    """Variance (rad^2) of the vertical about the usual one, which nobody knows before any step.

    A lean that shows as an acceleration in G, of the variance ``lasting``, is one, too.
    """
    prior = ANY_DIRECTION_VARIANCE / (1.0 + usual.proofs)
    leant = prior + max(0.0, usual.leant) / (1.0 + usual.steps) + lasting
    shaken = usual.shaken / (1.0 + usual.steps)
    of_mean = (leant + shaken) * min(1.0, dt_s / max(usual.seen_s, dt_s))
    return min(leant + of_mean, ANY_DIRECTION_VARIANCE)
