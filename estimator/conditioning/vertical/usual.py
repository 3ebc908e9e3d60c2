"""How a vehicle is usually tilted, for steps of which the gyroscope has shown nothing.

One that is shaken faster than its samples come turns by any angle between two of them, and stays
about where it was. Then the mean force, seen from the body, tells its tilt better than the latest
force does. What leans scatters the force's direction, and so does what shakes, but that scatters
the force's size as well: along gravity by as much as about either axis across it.
"""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.times import LATELY_S, LONG_S
from estimator.conditioning.vertical.lasting import MOST_APART_RAD
from estimator.conditioning.vertical.lowpass import approach
from estimator.geometry.quaternion import angle_between_vectors, norm, square
from estimator.geometry.spread import ANY_DIRECTION_VARIANCE
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3


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
