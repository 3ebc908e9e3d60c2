"""A gyroscope's scale error, seen where the vehicle keeps turning the same way.

An error of 0.3 % of a steady 140 deg/s about a level axis lets G drift by 0.4 deg/s, always about
that axis. The low-passed gravity follows 2.5 s behind, so the vertical leans by a degree, and a
steep field makes a heading error of some degrees of that. Turning to and fro averages out.
"""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.times import LONG_S
from estimator.conditioning.vertical.bias import clip
from estimator.conditioning.vertical.coefficients import Coefficients
from estimator.conditioning.vertical.gravity import GravityState
from estimator.conditioning.vertical.lasting import SCALE_ERROR
from estimator.conditioning.vertical.lowpass import Smooth, smooth
from estimator.geometry.quaternion import rotate, rotate_inverse, scale
from estimator.types import ZERO_VEC3, Vec2, Vec3

# The scale error of a small gyroscope; the largest that is believed is ``SCALE_ERROR``.
SCALE_SIGMA = 0.005
# What else levelling undoes: a white rate of this density, (rad/s)^2 s.
LEVELLING_NOISE = 3e-3


class Spin(NamedTuple):
    """A steady turn, and the gyroscope's error of scale that shows in it."""

    turn: Smooth = Smooth()  # low-passed rate, in G, rad/s
    scale_error: float = 0.0  # of the reading, as a share
    variance: float = SCALE_SIGMA**2  # of that share
    drift_rad_s: Vec3 = ZERO_VEC3  # what the error makes of the steady turn about level axes, FRD


@inlined
def follow_spin(
    params: ConditioningParams,
    k: Coefficients,
    state: Spin,
    gravity: GravityState,
    rate: Vec3,
    step: Vec2,
    learns: bool,
) -> Spin:
    """The steady turn after a learning step, the scale error that levelling shows, and its drift.

    The rate is low-passed in G as gravity is, so ``step``, by which levelling has turned about
    north and east (rad), belongs to it: -step/dt = e W about each, e being what is left of the
    scale error. Two updates of a scalar Kalman filter. What e W turns about down is the field's
    matter, which teaches heading and bias.
    """
    turn = smooth(k.gravity, state.turn, rotate(gravity.q_g_frd, rate))
    w = rotate(gravity.q_6d_g, turn.value)
    error = state.scale_error
    p = min(state.variance + SCALE_SIGMA**2 * k.dt_s / LONG_S, SCALE_SIGMA**2)
    if learns:
        north = -step[0] / k.dt_s
        error, p = learn_scale(params, error, p, w[0], north, k.dt_s)
        # the second drift is still that of the error before
        east = -step[1] / k.dt_s - (error - state.scale_error) * w[1]
        error, p = learn_scale(params, error, p, w[1], east, k.dt_s)
    if not params.use_scale_error:
        return Spin(turn, 0.0, p, ZERO_VEC3)
    level = rotate_inverse(gravity.q_6d_g, (w[0], w[1], 0.0))
    return Spin(turn, error, p, scale(error, rotate_inverse(gravity.q_g_frd, level)))


@inlined
def learn_scale(
    params: ConditioningParams,
    error: float,
    p: float,
    turn_rad_s: float,
    drift_rad_s: float,
    dt_s: float,
) -> tuple[float, float]:
    """Kalman update by drift = turn (scale error); the scale error and its variance."""
    m = p * turn_rad_s
    gain = m / (turn_rad_s * m + LEVELLING_NOISE / dt_s)
    drift = clip(drift_rad_s, params.bias_limit_rad_s)
    return clip(error + gain * drift, SCALE_ERROR), p - gain * m
