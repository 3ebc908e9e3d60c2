"""For how long gravity is averaged: the longer, the more shaking there is and the less turning.

Accelerations leave the more of an error in a low-passed force the shorter it is averaged; an error
of the gyroscope's scale lets frame G drift, in a turn that goes on, and the low-pass follows the
later the longer it averages. With errors that go as A/tau and W tau the best time is as the root
of A/W. A vehicle that is carried about asks for 4 s, one that turns slowly for 2.
"""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.vertical.bias import Estimate
from estimator.conditioning.vertical.gravity import LEAST_FORCE_M_S2, Force
from estimator.conditioning.vertical.spin import SCALE_SIGMA, Spin
from estimator.geometry.quaternion import dot, scale, square, subtract

# A/W (s) that asks for ``gravity_tau_s``: how far the force of a second is tilted, over the rate
# of a turn that goes on, to which comes what stands for all other errors of a gyroscope (rad/s).
USUAL_RATIO_S = 0.04
LEAST_RATE_RAD_S = 0.21
# Time (s) of the means of both, and the shares of ``gravity_tau_s`` that it stays between.
MEMORY_S = 30.0
LEAST_FACTOR = 0.76
MOST_FACTOR = 1.35
# The fourth power of the factor may be off by this share before it is changed: changing it costs
# the low-passes' coefficients.
TOLERANCE = 0.2
# Before anything is known: shaking of 2 deg, and the turning at which it asks for the usual time.
USUAL_SHAKING = 0.03**2


class Averaging(NamedTuple):
    """How much longer than ``gravity_tau_s`` gravity is averaged, and what that follows from."""

    shaking: float = USUAL_SHAKING  # mean square tilt of the force of a second, rad^2
    # mean square of the rate that lets G drift, (rad/s)^2
    turning: float = USUAL_SHAKING / USUAL_RATIO_S**2 - LEAST_RATE_RAD_S**2
    factor: float = 1.0  # of ``gravity_tau_s``


@inlined
def tilting(force: Force) -> float:
    """Squared angle (rad^2) between the force of a second and the low-passed one, if small."""
    f, q = force.down.value, force.quick
    across = subtract(q, scale(dot(f, q) / square(f), f))
    return square(across) / square(f)


@inlined
def follow_averaging(
    params: ConditioningParams,
    state: Averaging,
    force: Force,
    spin: Spin,
    estimate: Estimate,
    missed: float,
    learns: bool,
    dt_s: float,
) -> Averaging:
    """The averaging time after a learning step; ``learns`` says whether the step may change it.

    ``missed`` (rad^2) is the variance of a turn beyond the gyroscope's end. What a vehicle at rest
    shows, and a stream so slow that a second is one reading, shall not be learnt.
    """
    if not learns or not params.use_averaging:
        return state
    if square(force.down.value) < LEAST_FORCE_M_S2**2:
        return state
    share = min(1.0, dt_s / MEMORY_S)
    shaking = state.shaking + share * (tilting(force) - state.shaking)
    turn = spin.turn.value
    # a missed turn, and an uncertain bias, count as what a scale error makes of a turn
    drift = square(turn) + missed / (SCALE_SIGMA * dt_s) ** 2
    turning = state.turning + share * (drift - state.turning)
    p = estimate.covariance
    unknown = (p[0] + p[4] + p[7]) / (3.0 * SCALE_SIGMA**2)
    drifting = turning + unknown + LEAST_RATE_RAD_S**2
    ratio = shaking / (drifting * USUAL_RATIO_S**2)
    if abs(ratio - state.factor**4) < TOLERANCE * ratio:
        return Averaging(shaking, turning, state.factor)
    factor = max(LEAST_FACTOR, min(MOST_FACTOR, ratio**0.25))
    return Averaging(shaking, turning, factor)
