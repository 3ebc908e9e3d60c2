"""Where down is: specific force low-passed in the gyro-propagated frame G.

Only the gyroscope carries G along from the body, so G is almost inertial and drifts slowly against
the earth. 6D is G made level by the correction C, with an arbitrary heading.
"""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.params import SPAN_S, USUAL_S, ConditioningParams
from estimator.conditioning.rate import FAST_STEP_S
from estimator.conditioning.vertical.lowpass import Coefficients, Smooth, approach, smooth
from estimator.geometry.quaternion import (
    cross,
    multiply,
    normalize,
    rotate,
    shortest_rotation,
    square,
    subtract,
    unit,
)
from estimator.types import DOWN, IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec2, Vec3

# Less smoothed force than this (m/s^2) has no direction: free fall.
LEAST_FORCE_M_S2 = 0.5
# The long mean of the low-passed force is taken over so many of its time constants.
LONG_MEAN = 3.0


class Force(NamedTuple):
    """Minus the specific force, seen in G: gravity, once accelerations have averaged out."""

    down: Smooth = Smooth()  # low-passed over ``gravity_tau_s``, m/s^2
    best: Smooth = Smooth()  # low-passed for as long as accelerations and turning require, m/s^2
    quick: Vec3 = ZERO_VEC3  # followed faster, m/s^2
    long: Vec3 = ZERO_VEC3  # mean of ``best`` over several time constants of ``down``, m/s^2
    age_s: float = 0.0  # since the low-pass began
    off: Vec3 = ZERO_VEC3  # by how much it differed from ``best``, a mean over ``USUAL_S``, m/s^2


class GravityState(NamedTuple):
    """Gravity low-passed in frame G, and the correction C that levels that."""

    q_6d_g: Quaternion = IDENTITY  # C, G to 6D
    force: Force = Force()  # in G


@inlined
def observe_gravity(
    params: ConditioningParams,
    k: Coefficients,
    state: GravityState,
    u: Vec3,
    share: float,
    slow: float,
) -> GravityState:
    """Low-pass ``u``, minus the specific force in G.

    In G gravity stands still, accelerations average out (what moves to and fro ends where it
    began), and turning causes no lag. The mean of forces is not tilted, as that of directions is,
    so the force is not normalised first. A running mean over the first ``gravity_tau_s`` starts it.
    A slow stream's vertical (``slow`` above 0) moves by ``share`` of its way
    (:mod:`estimator.conditioning.vertical.tilt`), the published one for its own time
    (:mod:`estimator.conditioning.vertical.averaging`). Source: Laidig and Seel 2023, doi
    10.1016/j.inffus.2022.10.014.
    """
    before, dt = state.force, k.dt_s
    age = before.age_s + dt
    warm_up = age <= params.gravity_tau_s or before.age_s == 0.0
    if not params.use_gravity_filter:
        down = best = Smooth(u, ZERO_VEC3)
    elif warm_up or slow > 0.0:
        a = max(dt / age, slow * share) if warm_up else share
        down = Smooth(approach(before.down.value, u, a), ZERO_VEC3)
        best = Smooth(approach(before.best.value, u, a), ZERO_VEC3)
    else:
        down, best = smooth(k.gravity, before.down, u), smooth(k.best, before.best, u)
    quick = approach(before.quick, u, max(k.quick_share, dt / age))
    long = approach(before.long, best.value, long_share(k, age))
    off = approach(before.off, subtract(u, before.best.value), max(dt / age, dt / (USUAL_S + dt)))
    return GravityState(state.q_6d_g, Force(down, best, quick, long, age, off))


@inlined
def lag_square(force: Force) -> float:
    """Squared angle (rad^2) by which the mean force of ``USUAL_S`` is off the vertical."""
    return square(cross(force.off, unit(force.best.value))) / STANDARD_GRAVITY_M_S2**2


@inlined
def long_share(k: Coefficients, age_s: float) -> float:
    """The share by which the long mean follows, ``age_s`` after the low-pass began."""
    return max(k.gravity_share / LONG_MEAN, k.dt_s / age_s)


@inlined
def age_after_hole(
    state: GravityState, share: float, slow: float, dt: float, interval_s: float
) -> GravityState:
    """What a hole in a fast stream leaves of the vertical's age.

    The first reading behind the hole, worth ``interval_s``, has made up ``share`` of the vertical.
    So the next ones count by that share, and not as little as after seconds of averaging.
    """
    if slow <= 0.0 or dt <= SPAN_S or not 0.0 < interval_s < FAST_STEP_S:
        return state
    before_s = state.force.age_s
    age_s = min(before_s, interval_s / max(share, interval_s / before_s))
    return state._replace(force=state.force._replace(age_s=age_s))


@inlined
def level_to(q_6d_g: Quaternion, down_g: Vec3) -> tuple[Quaternion, Vec2]:
    """C <- (shortest rotation of C f to the vertical) C; also the step about north and east."""
    f = rotate(q_6d_g, down_g)
    if square(f) < LEAST_FORCE_M_S2**2:
        return q_6d_g, (0.0, 0.0)
    z = unit(f)
    # z x DOWN = (z_y, -z_x, 0), the rotation vector of a small step
    return normalize(multiply(shortest_rotation(z, DOWN), q_6d_g)), (z[1], -z[0])


@inlined
def heading_frame(state: GravityState, share: float) -> Quaternion:
    """The rotation from G to 6D for the field: levelled by ``share`` of the published vertical."""
    down = approach(state.force.down.value, state.force.best.value, share)
    return level_to(state.q_6d_g, down)[0]
