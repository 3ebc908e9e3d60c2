"""One sample through the velocity aiding.

An error-state Kalman filter over attitude, velocity, biases and lags. The
specific force, integrated in NED, must give the velocities that are reported.
Where it does not, the attitude is wrong: a tilt shows at once, because gravity
then has a horizontal part, a heading error as soon as the vehicle accelerates
horizontally. Its attitude gives the vectors that the paper's filter follows.
Formulation with small turns in the inertial frame as in J. Sola 2017,
arXiv:1711.02508, section 7.
"""

from math import hypot

import numpy as np

from estimator.aiding.inertial import GRAVITY_NED, Prediction, bend, predict_motion
from estimator.aiding.lean import hear_report, lean_angle, watch_lean
from estimator.aiding.sources.field import observe_heading, wait_for_field
from estimator.aiding.sources.unaided import observe_slow_unaided, observe_unaided
from estimator.aiding.sources.velocity import Source, observe_velocity, wait_for_report
from estimator.aiding.trail import new_trail
from estimator.aiding.types import (
    ACC_BIAS,
    EARTH,
    FIELD_LAG,
    FILTER_ERROR,
    FILTER_LAG,
    GYR_BIAS,
    HARD_IRON,
    IMU_LAG,
    NO_REPORT,
    RECEIVER_ERROR,
    RECEIVER_LAG,
    SIZE,
    TURN,
    VELOCITY,
    Agreement,
    Agreements,
    AidingEstimate,
    AidingParams,
    AidingState,
    Array,
    FieldResidual,
    FieldState,
    LastStep,
    Lean,
    Report,
    Roughness,
    Scatter,
    Sigmas,
    Surroundings,
)
from estimator.aiding.uncertainty import heading_sigma, inclination_sigma
from estimator.aiding.unseen import add_hole, add_unseen_turn, watch_roughness
from estimator.compilation.compiled import inlined
from estimator.conditioning.rate import slow_share
from estimator.conditioning.types import FieldLook
from estimator.geometry.quaternion import add, exp, multiply, norm, normalize, rotate, subtract
from estimator.types import (
    IDENTITY,
    NO_SAMPLE,
    STANDARD_GRAVITY_M_S2,
    ZERO_VEC3,
    Quaternion,
    Sample,
    Vec3,
)

BEGIN_VELOCITY_SIGMA_M_S = 1.0
# Near the magnetic poles the horizontal field vanishes; less than this does not count as such.
LEAST_HORIZONTAL_GAUSS = 0.02
UNHEARD = Agreement(
    scatter=Scatter(noise_scale=1.0, innovation=1.0, reports=0.0), wait_s=0.0, doubt_s=0.0
)
# Stands for the step before the first one: steps this long teach nothing about lags.
FIRST_STEP_S = 1.0


def begin(
    params: AidingParams,
    q_ned_frd: Quaternion,
    gyr_bias: Vec3,
    sample: Sample,
    report: Report,
    tilt_sigma_rad: float,
    heading_sigma_rad: float,
    hard_iron_sigma_gauss: float,
) -> tuple[AidingState, Array, Array]:
    """State, covariance and trail at a first velocity report, from an attitude and a bias."""
    P = np.zeros((SIZE, SIZE))
    tilt, heading = tilt_sigma_rad**2, heading_sigma_rad**2
    diagonal = np.einsum("ii->i", P)
    diagonal[TURN : TURN + 3] = (tilt, tilt, heading)
    diagonal[VELOCITY : VELOCITY + 3] = BEGIN_VELOCITY_SIGMA_M_S**2
    diagonal[GYR_BIAS : GYR_BIAS + 3] = params.gyr_bias_sigma**2
    diagonal[ACC_BIAS : ACC_BIAS + 3] = params.acc_bias_sigma**2
    diagonal[IMU_LAG] = params.imu_lag_sigma_s**2
    diagonal[FILTER_LAG] = params.filter_lag_sigma_s**2
    diagonal[FILTER_ERROR : FILTER_ERROR + 3] = params.filter_error_m_s**2
    diagonal[RECEIVER_ERROR : RECEIVER_ERROR + 3] = params.receiver_error_m_s**2
    diagonal[FIELD_LAG] = params.field_lag_sigma_s**2
    diagonal[HARD_IRON : HARD_IRON + 3] = hard_iron_sigma_gauss**2
    state = AidingState(
        estimate=AidingEstimate(
            q_ned_frd=q_ned_frd,
            velocity_ned_m_s=report.velocity_ned_m_s,
            gyr_bias_rad_s=gyr_bias,
            acc_bias_m_s2=ZERO_VEC3,
            imu_lag_s=params.imu_lag_s,
            field_lag_s=params.field_lag_s,
            hard_iron_gauss=ZERO_VEC3,
            earth_gauss=ZERO_VEC3,
            receiver_lag_s=params.receiver_lag_s,
            filter_lag_s=0.0,
            receiver_error_m_s=ZERO_VEC3,
            filter_error_m_s=ZERO_VEC3,
        ),
        last=LastStep(
            gyr_rad_s=sample.gyr_rad_s,
            gyr_before_rad_s=sample.gyr_rad_s,
            force_ned_m_s2=rotate(q_ned_frd, sample.acc_m_s2),
            rate_rad_s=subtract(sample.gyr_rad_s, gyr_bias),
            dt_s=FIRST_STEP_S,
        ),
        field=FieldState(
            look=FieldLook(horizontal=0.0, down=0.0, confidence=1.0),
            residual=FieldResidual(slow_rad=0.0, square=0.0),
            samples=0.0,
            wait_s=0.0,
            doubt_s=0.0,
        ),
        agreement=Agreements(by_filter=UNHEARD, by_receiver=UNHEARD),
        sigma=Sigmas(
            inclination_rad=tilt_sigma_rad,
            heading_rad=heading_sigma_rad,
        ),
        rough=Roughness(bent=0.0, changed=0.0),
        lean=Lean(ZERO_VEC3, report.velocity_ned_m_s, report.velocity_ned_m_s),
    )
    return state, P, new_trail(add(state.last.force_ned_m_s2, GRAVITY_NED))


def blank_aiding(params: AidingParams) -> tuple[AidingState, Array, Array]:
    """The place of state, covariance and trail while there is no aiding."""
    state, P, trail = begin(params, IDENTITY, ZERO_VEC3, NO_SAMPLE, NO_REPORT, 0.0, 0.0, 0.0)
    return state, np.zeros_like(P), trail


def forget_biases(
    params: AidingParams, state: AidingState, covariance: Array
) -> tuple[AidingState, Array]:
    """The same attitude and velocity, from another IMU: its biases are as at the beginning."""
    P = covariance.copy()
    for first, sigma in (
        (GYR_BIAS, params.gyr_bias_sigma),
        (ACC_BIAS, params.acc_bias_sigma),
    ):
        P[first : first + 3, :] = 0.0
        P[:, first : first + 3] = 0.0
        for i in range(first, first + 3):
            P[i, i] = sigma**2
    estimate = state.estimate._replace(gyr_bias_rad_s=ZERO_VEC3, acc_bias_m_s2=ZERO_VEC3)
    return state._replace(estimate=estimate), P


@inlined
def part(x: Array, first: int) -> Vec3:
    """Three corrections from ``first`` on."""
    return (x[first], x[first + 1], x[first + 2])


@inlined
def apply_corrections(
    estimate: AidingEstimate, now: Prediction, x: Array
) -> tuple[AidingEstimate, Vec3]:
    """The estimate and the specific force (NED), with the corrections x to the prediction."""
    turn = exp(part(x, TURN))
    q = normalize(multiply(turn, now.q_ned_frd))
    change = part(x, ACC_BIAS)
    corrected = AidingEstimate(
        q_ned_frd=q,
        velocity_ned_m_s=add(now.velocity_ned_m_s, part(x, VELOCITY)),
        gyr_bias_rad_s=add(estimate.gyr_bias_rad_s, part(x, GYR_BIAS)),
        acc_bias_m_s2=add(estimate.acc_bias_m_s2, change),
        imu_lag_s=estimate.imu_lag_s + x[IMU_LAG],
        field_lag_s=estimate.field_lag_s + x[FIELD_LAG],
        hard_iron_gauss=add(estimate.hard_iron_gauss, part(x, HARD_IRON)),
        earth_gauss=add(estimate.earth_gauss, part(x, EARTH)),
        receiver_lag_s=estimate.receiver_lag_s + x[RECEIVER_LAG],
        filter_lag_s=estimate.filter_lag_s + x[FILTER_LAG],
        receiver_error_m_s=add(now.receiver_error_m_s, part(x, RECEIVER_ERROR)),
        filter_error_m_s=add(now.filter_error_m_s, part(x, FILTER_ERROR)),
    )
    return corrected, subtract(rotate(turn, now.force_ned_m_s2), rotate(q, change))


@inlined
def settle(
    estimate: AidingEstimate, now: Prediction, x: Array
) -> tuple[AidingEstimate, Prediction]:
    """Estimate and prediction with the corrections so far."""
    corrected, force = apply_corrections(estimate, now, x)
    return corrected, Prediction(
        q_ned_frd=corrected.q_ned_frd,
        velocity_ned_m_s=corrected.velocity_ned_m_s,
        force_ned_m_s2=force,
        rate_rad_s=now.rate_rad_s,
        receiver_error_m_s=corrected.receiver_error_m_s,
        filter_error_m_s=corrected.filter_error_m_s,
        trail=now.trail,
        covariance=now.covariance,
    )


@inlined
def sigmas(
    params: AidingParams,
    P: Array,
    estimate: AidingEstimate,
    last: LastStep,
    field: FieldState,
    agreement: Agreements,
) -> Sigmas:
    """How uncertain the estimate is after a sample."""
    force = last.force_ned_m_s2
    pushed = params.pushed_rad * hypot(force[0], force[1]) / STANDARD_GRAVITY_M_S2
    moving = hypot(params.timing_s * norm(last.rate_rad_s), pushed)
    iron = iron_angle(params, estimate)
    return Sigmas(
        inclination_rad=inclination_sigma(params, P, agreement, moving),
        heading_rad=heading_sigma(params, P, agreement, field, iron, moving, last.dt_s),
    )


@inlined
def iron_angle(params: AidingParams, estimate: AidingEstimate) -> float:
    """How far (rad) the hard iron of a calibrated compass may turn the field."""
    E = estimate.earth_gauss
    return params.hard_iron_sigma_gauss / max(hypot(E[0], E[1]), LEAST_HORIZONTAL_GAUSS)


@inlined
def take_report(
    params: AidingParams,
    agreement: Agreements,
    before: AidingEstimate,
    now: Prediction,
    dt: float,
    report: Report,
    gravity_b: Vec3,
    x: Array,
) -> Agreements:
    """Learn from a report as of the source that it comes from."""
    by_filter, by_receiver = agreement.by_filter, agreement.by_receiver
    if report.late_sigma_s > 0.0:
        source = Source(
            is_receiver=True,
            error_m_s=now.receiver_error_m_s,
            age_s=report.ago_s + before.receiver_lag_s - before.imu_lag_s,
            error_at=RECEIVER_ERROR,
            lag_at=RECEIVER_LAG,
            is_alone=by_filter.wait_s >= params.silence_s,
        )
        by_receiver = observe_velocity(params, by_receiver, now, source, dt, report, gravity_b, x)
    else:
        source = Source(
            is_receiver=False,
            error_m_s=now.filter_error_m_s,
            age_s=report.ago_s + before.filter_lag_s - before.imu_lag_s,
            error_at=FILTER_ERROR,
            lag_at=FILTER_LAG,
            is_alone=by_receiver.wait_s >= params.silence_s,
        )
        by_filter = observe_velocity(params, by_filter, now, source, dt, report, gravity_b, x)
    return Agreements(by_filter=by_filter, by_receiver=by_receiver)


@inlined
def watch_turning(
    params: AidingParams, state: AidingState, now: Prediction, sample: Sample
) -> Roughness:
    """What the step of a slow stream has missed goes into the covariance, in place."""
    last, dt, between = state.last, sample.dt_s, sample.between
    change = subtract(sample.gyr_rad_s, last.gyr_rad_s)
    bent = bend(sample.gyr_rad_s, last.gyr_rad_s, last.gyr_before_rad_s, dt, last.dt_s)
    seen_s = dt
    if between.given:
        change = bent = between.change_rad_s
        seen_s = between.step_s
    add_unseen_turn(params, now.covariance, state.rough, bent, dt, seen_s)
    add_hole(now.covariance, dt)
    return watch_roughness(state.rough, bent, change, dt)


@inlined
def aid(
    params: AidingParams,
    state: AidingState,
    P: Array,
    trail: Array,
    sample: Sample,
    report: Report,
    others: Surroundings,
) -> tuple[AidingState, Array, Array]:
    """One sample, ``dt_s`` > 0 after the one before: predict, then learn from what there is.

    The covariance and the trail given stay as they are.
    """
    dt = sample.dt_s
    before = state.estimate
    now = predict_motion(params, state, P, trail, sample)
    x = np.zeros(SIZE)
    agreement = Agreements(
        by_filter=wait_for_report(state.agreement.by_filter, dt),
        by_receiver=wait_for_report(state.agreement.by_receiver, dt),
    )
    rough, lean = state.rough, state.lean
    slow = slow_share(dt)
    if slow > 0.0:
        rough = watch_turning(params, state, now, sample)
        wait_s = min(agreement.by_filter.wait_s, agreement.by_receiver.wait_s)
        is_silent = not report.given and wait_s > params.silence_s + dt
        sigma_rad = others.gravity_sigma_rad
        lean_rad = lean_angle(lean, is_silent)
        observe_slow_unaided(now, others.gravity_b, sigma_rad, lean_rad, x, slow, dt)
        # large turns do not add up, so this one is made before the next is looked for
        before, now = settle(before, now, x)
        x = np.zeros(SIZE)
    if report.given:
        agreement = take_report(params, agreement, before, now, dt, report, others.gravity_b, x)
    elif min(agreement.by_filter.wait_s, agreement.by_receiver.wait_s) > params.silence_s:
        observe_unaided(params, now, others.gravity_b, x, dt)
    field = wait_for_field(state.field, dt)
    if sample.has_mag:
        field = observe_heading(params, field, before, now, others, sample, x)
    estimate, force = apply_corrections(before, now, x)
    last = LastStep(
        gyr_rad_s=sample.gyr_rad_s,
        gyr_before_rad_s=state.last.gyr_rad_s,
        force_ned_m_s2=force,
        rate_rad_s=now.rate_rad_s,
        dt_s=dt,
    )
    sigma = sigmas(params, now.covariance, estimate, last, field, agreement)
    lean = watch_lean(lean, force, dt)
    if report.given:
        lean = hear_report(lean, report.velocity_ned_m_s)
    state = AidingState(
        estimate=estimate,
        last=last,
        field=field,
        agreement=agreement,
        sigma=sigma,
        rough=rough,
        lean=lean,
    )
    return state, now.covariance, now.trail


@inlined
def take_late_report(
    params: AidingParams,
    state: AidingState,
    P: Array,
    trail: Array,
    gravity_b: Vec3,
    report: Report,
) -> tuple[AidingState, Array]:
    """A report that came behind the sample it belongs to, before the next one."""
    before, last = state.estimate, state.last
    now = Prediction(
        q_ned_frd=before.q_ned_frd,
        velocity_ned_m_s=before.velocity_ned_m_s,
        force_ned_m_s2=last.force_ned_m_s2,
        rate_rad_s=last.rate_rad_s,
        receiver_error_m_s=before.receiver_error_m_s,
        filter_error_m_s=before.filter_error_m_s,
        trail=trail,
        covariance=P.copy(),
    )
    x = np.zeros(SIZE)
    agreement = take_report(params, state.agreement, before, now, last.dt_s, report, gravity_b, x)
    estimate, force = apply_corrections(before, now, x)
    last = LastStep(
        gyr_rad_s=last.gyr_rad_s,
        gyr_before_rad_s=last.gyr_before_rad_s,
        force_ned_m_s2=force,
        rate_rad_s=last.rate_rad_s,
        dt_s=last.dt_s,
    )
    state = AidingState(
        estimate=estimate,
        last=last,
        field=state.field,
        agreement=agreement,
        sigma=state.sigma,
        rough=state.rough,
        lean=hear_report(state.lean, report.velocity_ned_m_s),
    )
    return state, now.covariance
