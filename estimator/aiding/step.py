"""One sample through the velocity aiding.

An error-state Kalman filter over attitude, velocity, biases and lags. The specific force,
integrated in NED, must give the reported velocities. If it does not, the attitude is wrong: a tilt
shows at once, because gravity then has a horizontal part, and a heading error as soon as the
vehicle accelerates horizontally. The paper's filter follows the vectors of this attitude.
Formulation with small turns in the inertial frame as in J. Sola 2017, arXiv:1711.02508, section 7.
"""

import numpy as np

from estimator.aiding.acceleration_tilt import acceleration_tilt_angle, watch_acceleration_tilt
from estimator.aiding.correction_cusum import add_correction, known, pass_time
from estimator.aiding.covariance import part
from estimator.aiding.force_fault import take_back
from estimator.aiding.gyroscope_fault import track_errors, watch_gyroscope
from estimator.aiding.inertial import (
    Prediction,
    apply_corrections,
    correct_last,
    judge_biases,
    predict_motion,
    prediction_at,
    watch_knocks,
)
from estimator.aiding.sources.field import begin_anew, forget_iron, observe_heading
from estimator.aiding.sources.unaided import level, level_by_force
from estimator.aiding.sources.velocity import take_report, wait_for_reports
from estimator.aiding.sources.wheels import is_turned, judge_north, observe_wheels, rolls
from estimator.aiding.types import (
    SIZE,
    TURN,
    AidingParams,
    AidingState,
    Array,
    FieldState,
    LastStep,
    North,
    Report,
    StepInputs,
    Wheels,
)
from estimator.aiding.uncertainty import sigmas
from estimator.aiding.unseen import watch_turning
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import ACCELERATION_LASTS_S, CONFIRM_S, SPAN_S
from estimator.conditioning.rate import slow_share
from estimator.types import Sample, Vec3


@inlined
def aid(
    params: AidingParams,
    state: AidingState,
    P: Array,
    velocity_history: Array,
    sample: Sample,
    report: Report,
    others: StepInputs,
) -> tuple[AidingState, Array, Array]:
    """One sample, ``dt_s`` > 0 after the one before: predict, then learn from what there is.

    The covariance and the velocity_history given stay as they are.
    """
    dt = sample.dt_s
    slow = slow_share(dt)
    now = predict_motion(params, state, P, velocity_history, sample)
    agreement = wait_for_reports(state.agreement, dt)
    cusum = pass_time(params, state.correction_cusum, now.estimate, now.covariance, dt)
    rough = watch_knocks(now.covariance, state.rough, now.velocity_history, dt)
    if slow > 0.0:
        aliasing = slow * others.aliasing
        rough = watch_turning(params, state.last, rough, now.covariance, sample, aliasing)
    wait_s = min(agreement.by_filter.wait_s, agreement.by_receiver.wait_s)
    is_silent = not report.given and wait_s > SPAN_S + dt
    if is_silent or slow > 0.0:
        tilt_error_rad = acceleration_tilt_angle(state.acceleration_tilt, is_silent, slow)
        share = 1.0 if is_silent else slow
        now, cusum = level(now, cusum, others, tilt_error_rad, share, dt)
    gyroscope_fault = watch_gyroscope(state, others.gyr_errors, dt)
    track_errors(params, now, state.gyroscope_fault, gyroscope_fault)
    if others.unsensed_turn > 0.0:
        now = level_by_force(now, others)
    if others.wrong_force.variance > 0.0:
        now = take_back(now, others.wrong_force)
    before, x = known(now.covariance), np.zeros(SIZE)
    if report.given:
        agreement = take_report(params, agreement, now, dt, report, others.gravity_b, x)
    field, wheels = observe_field_and_wheels(params, state, now, sample, others, x)
    now = apply_corrections(now, x)
    cusum = add_correction(cusum, part(x, TURN), before, known(now.covariance))
    bias_prior = judge_biases(now, state.bias_prior)
    last = LastStep(
        gyr_rad_s=sample.gyr_rad_s,
        gyr_before_rad_s=state.last.gyr_rad_s,
        force_ned_m_s2=now.force_ned_m_s2,
        rate_rad_s=now.rate_rad_s,
        dt_s=dt,
    )
    acceleration_tilt = watch_acceleration_tilt(state.acceleration_tilt, now.force_ned_m_s2, dt)
    if report.given:
        acceleration_tilt = acceleration_tilt._replace(latest_m_s=report.velocity_ned_m_s)
    state = AidingState(
        estimate=now.estimate,
        last=last,
        field=field,
        agreement=agreement,
        sigma=sigmas(params, now, field, agreement),
        rough=rough,
        acceleration_tilt=acceleration_tilt,
        correction_cusum=cusum,
        wheels=wheels,
        bias_prior=bias_prior,
        gyroscope_fault=gyroscope_fault,
    )
    return state, now.covariance, now.velocity_history


@inlined
def observe_field_and_wheels(
    params: AidingParams,
    state: AidingState,
    now: Prediction,
    sample: Sample,
    others: StepInputs,
    x: Array,
) -> tuple[FieldState, Wheels]:
    """Learn from the sample's field, and from the vehicle's rolling if it has wheels."""
    dt, north, wheels = sample.dt_s, others.north, state.wheels
    field = state.field._replace(wait_s=state.field.wait_s + dt)
    if rolls(params):
        if field.samples > 0.0:
            wheels = judge_north(wheels, now, north)
        others = others._replace(north=North(north.is_known and wheels.show_north, north.direction))
    if sample.has_mag:
        field = observe_heading(params, field, now, others, sample, x)
    if rolls(params):
        wheels = observe_wheels(params, now, wheels, x, dt)
        has_rolled = state.wheels.rolled_s < ACCELERATION_LASTS_S <= wheels.rolled_s
        is_other = north.is_known and has_rolled and is_turned(now, north)
        if is_other or field.far_off_s > CONFIRM_S:
            # velocity shows the heading, so the field is another one, and iron was learnt in error
            field, wheels = begin_anew(field), wheels._replace(show_north=False)
            forget_iron(params, now.covariance, x, now.estimate.hard_iron_gauss)
    return field, wheels


@inlined
def take_late_report(
    params: AidingParams,
    state: AidingState,
    P: Array,
    velocity_history: Array,
    gravity_b: Vec3,
    report: Report,
) -> tuple[AidingState, Array]:
    """A report that came behind the sample it belongs to, before the next one."""
    now = prediction_at(state, P, velocity_history)
    x = np.zeros(SIZE)
    agreement = take_report(params, state.agreement, now, state.last.dt_s, report, gravity_b, x)
    acceleration_tilt = state.acceleration_tilt._replace(latest_m_s=report.velocity_ned_m_s)
    cusum = add_correction(state.correction_cusum, part(x, TURN), known(P), known(now.covariance))
    return correct_last(state, now, x)._replace(
        agreement=agreement, acceleration_tilt=acceleration_tilt, correction_cusum=cusum
    ), now.covariance
