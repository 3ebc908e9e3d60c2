"""What is learnt at a sample, put into the estimate: true value = estimate + error."""

from estimator.aiding.inertial import Prediction
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
    TURN,
    VELOCITY,
    AidingEstimate,
    AidingState,
    Array,
    LastStep,
)
from estimator.compilation.compiled import inlined, replacer
from estimator.geometry.quaternion import add, exp, multiply, normalize, rotate, subtract
from estimator.types import Vec3

with_estimate = replacer(Prediction, "estimate", "force_ned_m_s2")
with_force = replacer(LastStep, "force_ned_m_s2")
with_last = replacer(AidingState, "estimate", "last")


@inlined
def part(x: Array, first: int) -> Vec3:
    """Three corrections from ``first`` on."""
    return (x[first], x[first + 1], x[first + 2])


@inlined
def apply_corrections(now: Prediction, x: Array) -> Prediction:
    """What is known at a sample with the corrections x; velocity history and covariance stay."""
    before = now.estimate
    turn = exp(part(x, TURN))
    q = normalize(multiply(turn, before.q_ned_frd))
    change = part(x, ACC_BIAS)
    estimate = AidingEstimate(
        q_ned_frd=q,
        velocity_ned_m_s=add(before.velocity_ned_m_s, part(x, VELOCITY)),
        gyr_bias_rad_s=add(before.gyr_bias_rad_s, part(x, GYR_BIAS)),
        acc_bias_m_s2=add(before.acc_bias_m_s2, change),
        imu_lag_s=before.imu_lag_s + x[IMU_LAG],
        acc_lead_s=before.acc_lead_s,
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
    return with_estimate(now, estimate, force)


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
    return with_last(state, learnt.estimate, with_force(state.last, learnt.force_ned_m_s2))
