"""Where down is: specific force low-passed in the gyro-propagated frame G."""

from math import sqrt

from estimator.compiled import compiled
from estimator.conditioning.lowpass import running_mean, smooth
from estimator.conditioning.types import ConditioningParams, GravityState, LowPass, Smooth
from estimator.quaternion import exp, multiply, norm, normalize, rotate, scale, shortest_rotation
from estimator.types import Vec3

DOWN: Vec3 = (0.0, 0.0, 1.0)
# Less smoothed force than this (m/s^2) has no direction: free fall.
LEAST_FORCE_M_S2 = 0.5


@compiled
def propagate_frame(state: GravityState, rate: Vec3, dt_s: float) -> GravityState:
    """q_G <- q_G exp((w - b) dt): body to G, which only gyro errors move."""
    q = normalize(multiply(state.q_g_frd, exp(scale(dt_s, rate))))
    return GravityState(q, state.q_6d_g, state.down, state.levelling_rate_rad_s, state.age_s)


@compiled
def observe_gravity(
    params: ConditioningParams, k: LowPass, state: GravityState, acc: Vec3, dt_s: float
) -> GravityState:
    """Low-pass -acc in G and level: the smallest rotation C that takes it to the vertical.

    In G gravity stands still while accelerations come and go (a body moving to
    and fro ends where it began, so their mean vanishes); the low-pass there
    has no lag under rotation. The force is not normalised first: the mean of
    directions is tilted where the mean of forces is not. A running mean over
    the first ``gravity_tau_s`` starts it.
    Source: Laidig and Seel 2023, doi 10.1016/j.inffus.2022.10.014.
    """
    u = rotate(state.q_g_frd, scale(-1.0, acc))
    age = state.age_s + dt_s
    if not params.use_gravity_filter:
        down = Smooth(u, (0.0, 0.0, 0.0))
    elif age <= params.gravity_tau_s:
        down = running_mean(state.down, u, dt_s / age)
    else:
        down = smooth(k, state.down, u)
    return level(GravityState(state.q_g_frd, state.q_6d_g, down, (0.0, 0.0), age), dt_s)


@compiled
def level(state: GravityState, dt_s: float) -> GravityState:
    """C <- (shortest rotation of C f to the vertical) C, and its rate about the horizontal axes."""
    f = state.down.value
    if norm(f) < LEAST_FORCE_M_S2:
        return GravityState(state.q_g_frd, state.q_6d_g, state.down, (0.0, 0.0), state.age_s)
    z = rotate(state.q_6d_g, f)
    n = sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])
    step = shortest_rotation(z, DOWN)
    q = normalize(multiply(step, state.q_6d_g))
    # z x DOWN = (z_y, -z_x, 0): the rotation vector of a small levelling step
    rate = (z[1] / (n * dt_s), -z[0] / (n * dt_s))
    return GravityState(state.q_g_frd, q, state.down, rate, state.age_s)
