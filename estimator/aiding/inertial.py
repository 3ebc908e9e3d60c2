"""Attitude and velocity from one sample to the next, by gyroscope and accelerometer.

What is learnt at a sample is put into the estimate: true value = estimate + error.
"""

from math import exp as real_exp
from math import sqrt
from typing import NamedTuple

import numpy as np

from estimator.aiding.covariance import move_rows, part, rotation_matrix
from estimator.aiding.types import (
    ACC_BIAS,
    COMPASS_TURN,
    EARTH,
    FIELD_LAG,
    FILTER_ERROR,
    FILTER_LAG,
    GYR_BIAS,
    HARD_IRON,
    IMU_LAG,
    RECEIVER_ERROR,
    RECEIVER_LAG,
    SIZE,
    TURN,
    VELOCITY,
    AidingEstimate,
    AidingParams,
    AidingState,
    Array,
    BiasPrior,
    LastStep,
    Roughness,
)
from estimator.aiding.velocity_history import ACCELERATION, TIME, extend_velocity_history
from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import FAR, FORGET_S, REACH, USUAL_S
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
from estimator.types import STANDARD_GRAVITY_M_S2, Sample, Vec3

GRAVITY_NED: Vec3 = (0.0, 0.0, STANDARD_GRAVITY_M_S2)
# The time in which the vehicle's own field, or a sensor's bias, may have become another.
LEARNT_LASTS_S = 2500.0
# Forces usually lie at least this far off the line through two others, m/s^2: noise and shaking.
LEAST_KNOCK_M_S2 = 2.0


class Prediction(NamedTuple):
    """What is expected at a sample, before anything but the IMU has been looked at."""

    estimate: AidingEstimate
    force_ned_m_s2: Vec3  # specific force, NED
    rate_rad_s: Vec3  # free of bias, FRD
    velocity_history: Array  # of the velocity gained lately
    covariance: Array  # (SIZE, SIZE) of the errors; learning changes it in place


@inlined
def predict_motion(
    params: AidingParams, state: AidingState, P: Array, velocity_history: Array, sample: Sample
) -> Prediction:
    """One strapdown step: q <- q exp((w - b) dt), v <- v + (R f + g) dt by the trapezoid."""
    gyr, dt = sample.gyr_rad_s, sample.dt_s
    before, estimate = state.last, state.estimate
    rate = integration_rate(before.gyr_rad_s, gyr, dt, averaged=False)
    between = sample.between
    if between.given:
        rate = between.turn_rad_s
    rate = subtract(rate, estimate.gyr_bias_rad_s)
    q = normalize(multiply(estimate.q_ned_frd, exp(scale(dt, rate))))
    turning = subtract(gyr, estimate.gyr_bias_rad_s)
    ahead = exp(scale(estimate.acc_lead_s, turning))  # where the accelerometer was read
    force = rotate(multiply(q, ahead), subtract(sample.acc_m_s2, estimate.acc_bias_m_s2))
    gained = scale(0.5 * dt, add(force, before.force_ned_m_s2))
    fallen = scale(dt, GRAVITY_NED)
    v = add(add(estimate.velocity_ned_m_s, gained), fallen)
    velocity_history = extend_velocity_history(
        velocity_history, add(gained, fallen), add(force, GRAVITY_NED), dt
    )
    R = rotation_matrix(q)
    half = move_rows(P, R, gained, dt)  # F P, and then F P F': P is symmetric
    P = move_rows(np.ascontiguousarray(half.T), R, gained, dt)
    second_difference, _, seen_s = differences(before, sample)
    aliased_turn = rotate(q, scale(sqrt(dt * seen_s), second_difference))
    aliased_push = scale(dt, newest_deviation(velocity_history))
    unseen = (params.gyr_slow_noise_1_s * seen_s) ** 2 * dot(rate, rate) * dt
    add_noise(params, P, estimate.earth_gauss, aliased_turn, aliased_push, unseen, dt)
    estimate = age_errors(params, P, state, dt)._replace(q_ned_frd=q, velocity_ned_m_s=v)
    return Prediction(estimate, force, rate, velocity_history, P)


@inlined
def differences(last: LastStep, sample: Sample) -> tuple[Vec3, Vec3, float]:
    """Second and first difference (rad/s) of the rates, and how far apart in time those are (s).

    The rates are those that others have seen between the samples, or the gyroscope's.
    """
    gyr, between = sample.gyr_rad_s, sample.between
    if between.given:
        return between.change_rad_s, between.change_rad_s, between.step_s
    second_difference = line_deviation(
        gyr, last.gyr_rad_s, last.gyr_before_rad_s, sample.dt_s, last.dt_s
    )
    return second_difference, subtract(gyr, last.gyr_rad_s), sample.dt_s


@inlined
def line_deviation(third: Vec3, second: Vec3, first: Vec3, dt: float, before_s: float) -> Vec3:
    """How far the last of three readings lies off the line through the two before."""
    return subtract(
        subtract(third, second), scale(min(1.0, dt / before_s), subtract(second, first))
    )


@inlined
def newest_deviation(velocity_history: Array) -> Vec3:
    """How far the newest force (NED) lies off the line through the two before it."""
    third, second = part(velocity_history[0], ACCELERATION), part(velocity_history[1], ACCELERATION)
    first = part(velocity_history[2], ACCELERATION)
    step_s = velocity_history[0, TIME] - velocity_history[1, TIME]
    before_s = velocity_history[1, TIME] - velocity_history[2, TIME]
    return line_deviation(third, second, first, step_s, before_s)


@inlined
def watch_knocks(P: Array, rough: Roughness, velocity_history: Array, dt: float) -> Roughness:
    """The roughness after one more force.

    A force far off the line through its neighbours may be no push at all, and counts little. Its
    effect on the velocity is as uncertain as it is large, in place. An autopilot's filter reads the
    same accelerometer and makes the same error, so its reports prove nothing.
    """
    off = newest_deviation(velocity_history)
    square, most = dot(off, off), FAR * max(rough.knocked, LEAST_KNOCK_M_S2**2)
    beyond = 1.0 - most / max(square, TINY)
    if beyond > 0.0:
        for i in range(3):
            variance = beyond * (dt * off[i]) ** 2
            v, e = VELOCITY + i, FILTER_ERROR + i
            P[v, v] += variance
            P[e, e] += variance
            P[v, e] -= variance
            P[e, v] -= variance
    knocked = rough.knocked + dt / (USUAL_S + dt) * (min(square, most) - rough.knocked)
    return rough._replace(knocked=knocked)


@inlined
def add_noise(
    params: AidingParams,
    P: Array,
    E: Vec3,
    aliased_turn: Vec3,
    aliased_push: Vec3,
    unseen: float,
    dt: float,
) -> None:
    """What a step adds to the covariance, in place, where the place's field is ``E``.

    The more two samples differ, the more may have happened between them. ``unseen`` (rad^2) is what
    else the step has missed of a turn about an axis.
    """
    aliasing = params.integration_noise**2
    push = params.acc_noise**2 * dt
    iron = params.hard_iron_sigma_gauss**2
    for i in range(3):
        P[TURN + i, TURN + i] += unseen + aliasing * aliased_turn[i] ** 2
        P[VELOCITY + i, VELOCITY + i] += push + aliasing * aliased_push[i] ** 2
        P[GYR_BIAS + i, GYR_BIAS + i] += params.gyr_bias_sigma**2 * dt / LEARNT_LASTS_S
        P[ACC_BIAS + i, ACC_BIAS + i] += params.acc_bias_sigma**2 * dt / LEARNT_LASTS_S
        if P[HARD_IRON + i, HARD_IRON + i] < iron:
            P[HARD_IRON + i, HARD_IRON + i] += iron * dt / LEARNT_LASTS_S
    field = NORM_SCALE**2 * dt / FORGET_S  # of its strength, as a share
    horizontal = field * (1.0 + E[2] * E[2] / max(E[0] * E[0] + E[1] * E[1], 1e-12))
    for i in range(2):  # the place's field may change its strength, not its declination
        for j in range(2):
            P[EARTH + i, EARTH + j] += horizontal * E[i] * E[j]
    P[EARTH + 2, EARTH + 2] += field * dot(E, E)


@inlined
def age_errors(params: AidingParams, P: Array, state: AidingState, dt: float) -> AidingEstimate:
    """The estimate with what is left of both sources' slow errors; their covariance in place."""
    estimate, (by_filter, by_receiver) = state.estimate, state.agreement
    pushed = state.last.force_ned_m_s2
    turning = params.filter_turning_s**2 * (pushed[0] ** 2 + pushed[1] ** 2)
    variance = (params.filter_error_m_s**2 + turning) * max(1.0, by_filter.scatter.noise_scale)
    of_filter = age_error(params, P, FILTER_ERROR, estimate.filter_error_m_s, variance, dt)
    variance = params.receiver_error_m_s**2 * max(1.0, by_receiver.scatter.noise_scale)
    of_receiver = age_error(params, P, RECEIVER_ERROR, estimate.receiver_error_m_s, variance, dt)
    return estimate._replace(filter_error_m_s=of_filter, receiver_error_m_s=of_receiver)


@inlined
def age_error(
    params: AidingParams, P: Array, first: int, error: Vec3, variance: float, dt: float
) -> Vec3:
    """What is left of a source's slow error, of the constant ``variance``; its covariance in place.

    It is first-order noise. A large error has jumped, and lasts long: otherwise the attitude would
    have to explain why it stays.
    """
    persistence = min(FAR, max(1.0, dot(error, error) / (REACH**2 * variance)))
    keep = real_exp(-dt / (params.error_tau_s * persistence))
    for i in range(first, first + 3):
        for j in range(SIZE):
            P[i, j] *= keep
            P[j, i] *= keep
        P[i, i] += variance * (1.0 - real_exp(-2.0 * (dt / params.error_tau_s)))
    return scale(keep, error)


@inlined
def judge_biases(now: Prediction, bias_prior: BiasPrior) -> BiasPrior:
    """How uncertain biases of both sensors are that nothing has shown; in place, too.

    Three axes are one sensor's: if one is off by more than expected, the others may be as far off,
    unless they have been learnt. At rest or in straight flight an accelerometer's bias across the
    force has turned the attitude: R a = turn x f.
    """
    P, estimate, per_bias = now.covariance, now.estimate, 1.0 / STANDARD_GRAVITY_M_S2
    R = rotation_matrix(estimate.q_ned_frd)
    return BiasPrior(
        gyr=judge_sensor(P, GYR_BIAS, estimate.gyr_bias_rad_s, bias_prior.gyr, R, 0.0),
        acc=judge_sensor(P, ACC_BIAS, estimate.acc_bias_m_s2, bias_prior.acc, R, per_bias),
    )


@inlined
def judge_sensor(
    P: Array, first: int, bias: Vec3, variance: float, R: Array, tilt_per_bias: float
) -> float:
    """The variance of a sensor's bias that nothing has shown, and that of its axes, in place.

    ``tilt_per_bias`` is by how much (rad) a bias across the vertical has turned the attitude.
    """
    largest = max(bias[0] * bias[0], bias[1] * bias[1], bias[2] * bias[2])
    if largest <= variance:
        return variance
    for k in range(3):
        i = first + k
        learnt = max(0.0, 1.0 / P[i, i] - 1.0 / variance)
        grown = max(0.0, 1.0 / (learnt + 1.0 / largest) - P[i, i])
        north, east = tilt_per_bias * R[1, k], -tilt_per_bias * R[0, k]
        P[i, i] += grown
        for j, turned in ((TURN, north), (TURN + 1, east)):
            P[i, j] += grown * turned
            P[j, i] += grown * turned
            P[j, j] += grown * turned * turned
        P[TURN, TURN + 1] += grown * north * east
        P[TURN + 1, TURN] += grown * north * east
    return largest


@inlined
def apply_corrections(now: Prediction, x: Array) -> Prediction:
    """What is known at a sample with the corrections x; velocity history and covariance stay."""
    before = now.estimate
    turn = exp(part(x, TURN))
    q = normalize(multiply(turn, before.q_ned_frd))
    change = part(x, ACC_BIAS)
    estimate = before._replace(
        q_ned_frd=q,
        velocity_ned_m_s=add(before.velocity_ned_m_s, part(x, VELOCITY)),
        gyr_bias_rad_s=add(before.gyr_bias_rad_s, part(x, GYR_BIAS)),
        acc_bias_m_s2=add(before.acc_bias_m_s2, change),
        imu_lag_s=before.imu_lag_s + x[IMU_LAG],
        field_lag_s=before.field_lag_s + x[FIELD_LAG],
        compass_turn_rad=before.compass_turn_rad + x[COMPASS_TURN],
        hard_iron_gauss=add(before.hard_iron_gauss, part(x, HARD_IRON)),
        earth_gauss=add(before.earth_gauss, part(x, EARTH)),
        receiver_lag_s=before.receiver_lag_s + x[RECEIVER_LAG],
        filter_lag_s=before.filter_lag_s + x[FILTER_LAG],
        receiver_error_m_s=add(before.receiver_error_m_s, part(x, RECEIVER_ERROR)),
        filter_error_m_s=add(before.filter_error_m_s, part(x, FILTER_ERROR)),
    )
    force = subtract(rotate(turn, now.force_ned_m_s2), rotate(q, change))
    return now._replace(estimate=estimate, force_ned_m_s2=force)


@inlined
def prediction_at(state: AidingState, P: Array, velocity_history: Array) -> Prediction:
    """What is known at the last sample, for a report that comes behind it. ``P`` is copied."""
    last = state.last
    return Prediction(
        state.estimate, last.force_ned_m_s2, last.rate_rad_s, velocity_history, P.copy()
    )


@inlined
def correct_last(state: AidingState, now: Prediction, x: Array) -> AidingState:
    """The state at the last sample with the corrections x to :func:`prediction_at`."""
    learnt = apply_corrections(now, x)
    return state._replace(
        estimate=learnt.estimate, last=state.last._replace(force_ned_m_s2=learnt.force_ned_m_s2)
    )
