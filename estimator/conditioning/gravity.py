"""Where down is: specific force low-passed in the gyro-propagated frame G."""

from math import exp as real_exp
from math import sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.lowpass import running_mean, smooth
from estimator.conditioning.types import (
    Coefficients,
    ConditioningParams,
    GravityState,
    Rows,
    Smooth,
    Two,
)
from estimator.geometry.quaternion import (
    exp,
    multiply,
    norm,
    normalize,
    rotate,
    rotate_inverse,
    scale,
    shortest_rotation,
)
from estimator.types import Quaternion, Vec3

NORTH: Vec3 = (1.0, 0.0, 0.0)
EAST: Vec3 = (0.0, 1.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)
# Less smoothed force than this (m/s^2) has no direction: free fall.
LEAST_FORCE_M_S2 = 0.5
# Averaging time (s) of how unsteady the force is.
UNSTEADY_TAU_S = 5.0


@inlined
def propagate_frame(state: GravityState, rate: Vec3, dt_s: float) -> GravityState:
    """q_G <- q_G exp((w - b) dt): body to G, which only gyro errors move."""
    q = normalize(multiply(state.q_g_frd, exp(scale(dt_s, rate))))
    return GravityState(q, state.q_6d_g, state.down, state.quick, state.unsteady, state.age_s)


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

    In G gravity stands still while accelerations come and go (what moves to
    and fro ends where it began, so their mean vanishes), and turning causes no
    lag. The force is not normalised first: the mean of directions is tilted
    where the mean of forces is not. A running mean over the first
    ``gravity_tau_s`` starts it. Of slow streams the vertical moves by ``share`` of
    its way, which :mod:`estimator.conditioning.tilt` has weighed.
    Source: Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014.
    """
    dt = k.dt_s
    age = state.age_s + dt
    if not params.use_gravity_filter:
        down = Smooth(u, (0.0, 0.0, 0.0))
    elif age <= params.gravity_tau_s or state.age_s == 0.0:
        down = running_mean(state.down, u, max(dt / age, slow * share))
    elif slow > 0.0:
        down = running_mean(state.down, u, share)
    else:
        down = smooth(k.gravity, state.down, u)
    a = max(1.0 - real_exp(-dt / params.turn_moving_tau_s), dt / age)
    q = state.quick
    quick = (q[0] + a * (u[0] - q[0]), q[1] + a * (u[1] - q[1]), q[2] + a * (u[2] - q[2]))
    f = down.value
    square = f[0] * f[0] + f[1] * f[1] + f[2] * f[2]
    off = (u[0] - f[0]) ** 2 + (u[1] - f[1]) ** 2 + (u[2] - f[2]) ** 2
    share = off / square if square > LEAST_FORCE_M_S2**2 else 1.0
    unsteady = state.unsteady + min(1.0, dt / UNSTEADY_TAU_S) * (share - state.unsteady)
    return GravityState(state.q_g_frd, state.q_6d_g, down, quick, unsteady, age)


@inlined
def level(state: GravityState) -> tuple[GravityState, Two]:
    """C <- (shortest rotation of C f to the vertical) C; also the step about north and east."""
    f = state.down.value
    if norm(f) < LEAST_FORCE_M_S2:
        return state, (0.0, 0.0)
    z = rotate(state.q_6d_g, f)
    n = sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])
    q = normalize(multiply(shortest_rotation(z, DOWN), state.q_6d_g))
    levelled = GravityState(state.q_g_frd, q, state.down, state.quick, state.unsteady, state.age_s)
    # z x DOWN = (z_y, -z_x, 0), the rotation vector of a small step
    return levelled, (z[1] / n, -z[0] / n)


@inlined
def reseed_gravity(state: GravityState, u: Vec3) -> GravityState:
    """The low-pass started anew at ``u``."""
    return GravityState(
        state.q_g_frd, state.q_6d_g, Smooth(u, (0.0, 0.0, 0.0)), u, state.unsteady, state.age_s
    )


@inlined
def restart_gravity(state: GravityState) -> GravityState:
    """The low-pass starts anew, as at the first sample."""
    zero = (0.0, 0.0, 0.0)
    return GravityState(state.q_g_frd, state.q_6d_g, Smooth(zero, zero), zero, state.unsteady, 0.0)


@inlined
def rows_of(q_6d_frd: Quaternion) -> Rows:
    """The rows of R6."""
    return Rows(
        rotate_inverse(q_6d_frd, NORTH),
        rotate_inverse(q_6d_frd, EAST),
        rotate_inverse(q_6d_frd, DOWN),
    )
