"""Attitude and velocity carried on by gyroscope and accelerometer."""

from typing import NamedTuple

from estimator.aiding.covariance import predict_covariance, rotation_matrix
from estimator.aiding.types import (
    ACC_BIAS,
    EARTH,
    GYR_BIAS,
    HARD_IRON,
    TURN,
    VELOCITY,
    AidingParams,
    AidingState,
    Array,
)
from estimator.compilation.compiled import inlined
from estimator.conditioning.rate import integration_rate
from estimator.geometry.quaternion import (
    add,
    dot,
    exp,
    multiply,
    normalize,
    rotate,
    scale,
    subtract,
)
from estimator.types import STANDARD_GRAVITY_M_S2, Quaternion, Sample, Vec3

SLOW_STEP_S = 0.3  # a step in which a copter's motion begins and ends unseen
HARD_IRON_WALK_S = 2500.0  # the time in which the remaining hard iron may become another


class Prediction(NamedTuple):
    """What is expected at a sample, before anything but the IMU has been looked at."""

    q_ned_frd: Quaternion  # body to NED
    velocity_ned_m_s: Vec3  # over ground
    force_ned_m_s2: Vec3  # specific force, NED
    rate_rad_s: Vec3  # free of bias, FRD
    covariance: Array  # (21, 21) of the errors; what is learnt at the sample changes it in place


@inlined
def predict_motion(
    params: AidingParams, state: AidingState, P: Array, sample: Sample
) -> Prediction:
    """One strapdown step: q <- q exp((w - b) dt), v <- v + (R f + g) dt by the trapezoid."""
    gyr, dt = sample.gyr_rad_s, sample.dt_s
    before, estimate = state.last, state.estimate
    rate = integration_rate(before.gyr_rad_s, gyr, dt, averaged=False)
    rate = subtract(rate, estimate.gyr_bias_rad_s)
    q = normalize(multiply(estimate.q_ned_frd, exp(scale(dt, rate))))
    force = rotate(q, subtract(sample.acc_m_s2, estimate.acc_bias_m_s2))
    gained = scale(0.5 * dt, add(force, before.force_ned_m_s2))
    v = add(estimate.velocity_ned_m_s, gained)
    v = (v[0], v[1], v[2] + STANDARD_GRAVITY_M_S2 * dt)
    P = predict_covariance(P, rotation_matrix(q), gained, dt)
    missed_turn = rotate(q, scale(dt, subtract(gyr, before.gyr_rad_s)))
    missed_push = scale(dt, subtract(force, before.force_ned_m_s2))
    add_noise(params, P, state, missed_turn, missed_push, dot(rate, rate), dt)
    return Prediction(
        q_ned_frd=q,
        velocity_ned_m_s=v,
        force_ned_m_s2=force,
        rate_rad_s=rate,
        covariance=P,
    )


@inlined
def unseen_share(params: AidingParams, dt: float) -> float:
    """Share of the change over a step that integration misses; more the slower the samples."""
    return params.integration_noise * (1.0 + (dt / SLOW_STEP_S) ** 2)


@inlined
def add_noise(
    params: AidingParams,
    P: Array,
    state: AidingState,
    missed_turn: Vec3,
    missed_push: Vec3,
    rate_square: float,
    dt: float,
) -> None:
    """What a step adds to the covariance, in place.

    Between two samples anything may happen that they do not show; how much is
    told by how much they differ.
    """
    missed = unseen_share(params, dt) ** 2
    relative = params.gyr_scale_noise**2 + (params.gyr_slow_noise_1_s * dt) ** 2
    turn = (params.gyr_noise**2 + relative * rate_square) * dt
    walk = state.agreement.scatter.noise_scale * params.velocity_walk**2
    push = (params.acc_noise**2 + walk) * dt
    iron = params.hard_iron_sigma_gauss**2
    for i in range(3):
        P[TURN + i, TURN + i] += turn + missed * missed_turn[i] ** 2
        P[VELOCITY + i, VELOCITY + i] += push + missed * missed_push[i] ** 2
        P[GYR_BIAS + i, GYR_BIAS + i] += params.gyr_bias_walk**2 * dt
        P[ACC_BIAS + i, ACC_BIAS + i] += params.acc_bias_walk**2 * dt
        if P[HARD_IRON + i, HARD_IRON + i] < iron:
            P[HARD_IRON + i, HARD_IRON + i] += iron * dt / HARD_IRON_WALK_S
    E = state.estimate.earth_gauss
    field = params.field_walk**2 * dt
    horizontal = field * (1.0 + E[2] * E[2] / max(E[0] * E[0] + E[1] * E[1], 1e-12))
    for i in range(2):  # its strength may change, not its direction from north
        for j in range(2):
            P[EARTH + i, EARTH + j] += horizontal * E[i] * E[j]
    P[EARTH + 2, EARTH + 2] += field * dot(E, E)
