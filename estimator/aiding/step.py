"""One sample through the velocity aiding.

An error-state Kalman filter over attitude, velocity, biases and lags. Specific
force integrated in NED is what velocity reports must show, so the difference
between two reports tells down, and any horizontal acceleration the heading; no
derivative is taken and nothing is low-passed. Its attitude gives the vectors
that the paper's filter follows. Formulation with small turns in the inertial
frame as in J. Sola 2017, arXiv:1711.02508, section 7.
"""

from math import hypot

import numpy as np

from estimator.aiding.inertial import Prediction, predict_motion
from estimator.aiding.sources.field import observe_heading, wait_for_field
from estimator.aiding.sources.velocity import (
    Step,
    observe_unaided,
    observe_velocity,
    wait_for_report,
)
from estimator.aiding.types import (
    ACC_BIAS,
    EARTH,
    FIELD_LAG,
    GYR_BIAS,
    HARD_IRON,
    IMU_LAG,
    REPORT_LAG,
    SIZE,
    TURN,
    VELOCITY,
    Agreement,
    AidingParams,
    AidingState,
    Array,
    Calibration,
    FieldState,
    Report,
    Two,
)
from estimator.aiding.uncertainty import heading_sigma, inclination_sigma
from estimator.compilation.compiled import inlined
from estimator.geometry.quaternion import add, exp, multiply, norm, normalize, rotate, subtract
from estimator.types import ZERO_VEC3, Quaternion, Vec3

BEGIN_VELOCITY_SIGMA_M_S = 1.0
LEAST_HORIZONTAL_GAUSS = 0.02  # near the magnetic poles
FIRST_STEP_S = 1.0  # no step yet: too long to tell lags from


def begin(
    params: AidingParams,
    q_ned_frd: Quaternion,
    gyr_bias: Vec3,
    gyr: Vec3,
    acc: Vec3,
    report: Report,
    heading_sigma_rad: float,
    hard_iron_sigma_gauss: float,
) -> tuple[AidingState, Array]:
    """State and covariance at a first velocity report, from an attitude and a bias."""
    P = np.zeros((SIZE, SIZE))
    tilt, heading = params.begin_tilt_sigma_rad**2, heading_sigma_rad**2
    diagonal = np.einsum("ii->i", P)
    diagonal[TURN : TURN + 3] = (tilt, tilt, heading)
    diagonal[VELOCITY : VELOCITY + 3] = BEGIN_VELOCITY_SIGMA_M_S**2
    diagonal[GYR_BIAS : GYR_BIAS + 3] = params.gyr_bias_sigma**2
    diagonal[ACC_BIAS : ACC_BIAS + 3] = params.acc_bias_sigma**2
    diagonal[IMU_LAG] = params.imu_lag_sigma_s**2
    diagonal[FIELD_LAG] = params.field_lag_sigma_s**2
    diagonal[HARD_IRON : HARD_IRON + 3] = hard_iron_sigma_gauss**2
    state = AidingState(
        q_ned_frd=q_ned_frd,
        velocity_ned_m_s=report.velocity_ned_m_s,
        gyr_bias_rad_s=gyr_bias,
        acc_bias_m_s2=ZERO_VEC3,
        imu_lag_s=params.imu_lag_s,
        field_lag_s=params.field_lag_s,
        hard_iron_gauss=ZERO_VEC3,
        earth_gauss=ZERO_VEC3,
        report_lag_s=params.report_lag_s,
        gyr_rad_s=gyr,
        force_ned_m_s2=rotate(q_ned_frd, acc),
        rate_rad_s=subtract(gyr, gyr_bias),
        step_s=FIRST_STEP_S,
        field=FieldState(0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0),
        agreement=Agreement(1.0, 1.0, 0.0, ZERO_VEC3, 0.0, 0.0, 0.0),
        sigma_inclination_rad=params.begin_tilt_sigma_rad,
        sigma_heading_rad=heading_sigma_rad,
    )
    return state, P


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
    return state._replace(gyr_bias_rad_s=ZERO_VEC3, acc_bias_m_s2=ZERO_VEC3), P


@inlined
def part(x: Array, first: int) -> Vec3:
    """Three corrections from ``first`` on."""
    return (x[first], x[first + 1], x[first + 2])


@inlined
def apply_corrections(
    state: AidingState, now: Prediction, agreement: Agreement, field: FieldState, x: Array
) -> AidingState:
    """The state with the corrections x applied to the prediction ``now``."""
    q = normalize(multiply(exp(part(x, TURN)), now.q_ned_frd))
    change = part(x, ACC_BIAS)
    return AidingState(
        q,
        add(now.velocity_ned_m_s, part(x, VELOCITY)),
        add(state.gyr_bias_rad_s, part(x, GYR_BIAS)),
        add(state.acc_bias_m_s2, change),
        state.imu_lag_s + x[IMU_LAG],
        state.field_lag_s + x[FIELD_LAG],
        add(state.hard_iron_gauss, part(x, HARD_IRON)),
        add(state.earth_gauss, part(x, EARTH)),
        state.report_lag_s + x[REPORT_LAG],
        state.gyr_rad_s,
        subtract(rotate(exp(part(x, TURN)), now.force_ned_m_s2), rotate(q, change)),
        now.rate_rad_s,
        state.step_s,
        field,
        agreement,
        state.sigma_inclination_rad,
        state.sigma_heading_rad,
    )


@inlined
def finish_sample(
    params: AidingParams, state: AidingState, P: Array, gyr: Vec3, dt: float
) -> AidingState:
    """The state after a sample, with its uncertainty."""
    turning = norm(state.rate_rad_s)
    return AidingState(
        state.q_ned_frd,
        state.velocity_ned_m_s,
        state.gyr_bias_rad_s,
        state.acc_bias_m_s2,
        state.imu_lag_s,
        state.field_lag_s,
        state.hard_iron_gauss,
        state.earth_gauss,
        state.report_lag_s,
        gyr,
        state.force_ned_m_s2,
        state.rate_rad_s,
        dt,
        state.field,
        state.agreement,
        inclination_sigma(params, P, state.agreement, turning),
        heading_sigma(
            params, P, state.agreement, state.field, iron_angle(params, state), turning, dt
        ),
    )


@inlined
def iron_angle(params: AidingParams, state: AidingState) -> float:
    """How far (rad) the hard iron of a calibrated compass may turn the field."""
    E = state.earth_gauss
    return params.hard_iron_sigma_gauss / max(hypot(E[0], E[1]), LEAST_HORIZONTAL_GAUSS)


@inlined
def aid(
    params: AidingParams,
    state: AidingState,
    P: Array,
    gravity_b: Vec3,
    north: Two,
    gyr: Vec3,
    acc: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt: float,
    report: Report,
) -> tuple[AidingState, Array]:
    """One sample, ``dt`` > 0 after the one before: carry on, then learn from what there is.

    ``gravity_b`` is the unaided stage's down, ``north`` magnetic north as (north, east). The
    covariance given stays as it is.
    """
    now = predict_motion(params, state, P, gyr, acc, dt)
    P = now.covariance
    x = np.zeros(SIZE)
    agreement = wait_for_report(state.agreement, dt)
    if report.given:
        agreement = observe_velocity(
            params,
            agreement,
            now,
            Step(dt, state.force_ned_m_s2, state.imu_lag_s, state.report_lag_s),
            report,
            gravity_b,
            P,
            x,
        )
    elif agreement.wait_s > params.silence_s:
        observe_unaided(params, now, gravity_b, P, x, dt)
    field = wait_for_field(state.field, dt)
    if has_mag:
        calibration = Calibration(
            state.gyr_bias_rad_s, state.hard_iron_gauss, state.earth_gauss, state.field_lag_s
        )
        field = observe_heading(params, field, calibration, now.q_ned_frd, north, gyr, mag, P, x)
    state = apply_corrections(state, now, agreement, field, x)
    return finish_sample(params, state, P, gyr, dt), P


@inlined
def take_late_report(
    params: AidingParams, state: AidingState, P: Array, gravity_b: Vec3, report: Report
) -> tuple[AidingState, Array]:
    """A report that came behind the sample it belongs to, before the next one."""
    P = P.copy()
    x = np.zeros(SIZE)
    force = state.force_ned_m_s2
    now = Prediction(state.q_ned_frd, state.velocity_ned_m_s, force, state.rate_rad_s, P)
    agreement = observe_velocity(
        params,
        state.agreement,
        now,
        Step(state.step_s, force, state.imu_lag_s, state.report_lag_s),
        report,
        gravity_b,
        P,
        x,
    )
    return apply_corrections(state, now, agreement, state.field, x), P
