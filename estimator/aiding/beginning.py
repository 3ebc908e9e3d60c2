"""Where the aiding begins: its state, its errors' covariance and the velocity history so far."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from estimator.aiding.inertial import GRAVITY_NED
from estimator.aiding.types import (
    ACC_BIAS,
    COMPASS_TURN,
    FIELD_LAG,
    FILTER_ERROR,
    FILTER_LAG,
    GYR_BIAS,
    HARD_IRON,
    IMU_LAG,
    NO_REPORT,
    RECEIVER_ERROR,
    SIZE,
    TURN,
    VELOCITY,
    AccelerationTilt,
    Agreements,
    AidingEstimate,
    AidingParams,
    AidingState,
    Array,
    BiasPrior,
    CorrectionCusum,
    GyroscopeFault,
    LastStep,
    Report,
    Sigmas,
)
from estimator.aiding.velocity_history import new_velocity_history
from estimator.bounds import TINY
from estimator.conditioning.params import FAR, REACH, SPAN_S
from estimator.geometry.quaternion import HALF_TURN_VARIANCE, add, norm, rotate, subtract
from estimator.types import IDENTITY, NO_SAMPLE, ZERO_VEC3, Quaternion, Sample, Vec3

BEGIN_VELOCITY_SIGMA_M_S = 1.0


class Start(NamedTuple):
    """What is known where the aiding begins, each with its sigma."""

    q_ned_frd: Quaternion  # body to NED
    heading_sigma_rad: float  # about down
    tilt_sigma_rad: float = 0.0  # about north and east; 0: that of the unaided vertical
    compass_sigma_rad: float = 0.0  # of how the compass is turned in the vehicle
    turned_by_iron_1_gauss: Vec3 = ZERO_VEC3  # what hard iron (FRD) does to a heading by the field
    hard_iron_sigma_gauss: float = 0.0  # of the vehicle's own field, each axis
    tilt_by_bias_rad: float = 0.0  # what either sensor's bias may have tilted the vertical by
    gyr_bias_rad_s: Vec3 = ZERO_VEC3  # FRD
    field_lag_s: float = 0.0  # of the magnetometer's readings, and the sigma of that

    @property
    def sigma(self) -> Sigmas:
        """Of the attitude, where that of its tilt is given."""
        return Sigmas(self.tilt_sigma_rad, self.heading_sigma_rad)


def lag_variance(lag_s: float) -> float:
    """Variance (s^2) of an IMU's lag that only the usual delay of its samples shows."""
    return (lag_s / REACH) ** 2


def begin(
    params: AidingParams, first: Start, sample: Sample, report: Report
) -> tuple[AidingState, Array, Array]:
    """State, covariance and velocity history at a first velocity report."""
    P = np.zeros((SIZE, SIZE))
    q_ned_frd, gyr_bias, iron = first.q_ned_frd, first.gyr_bias_rad_s, first.hard_iron_sigma_gauss
    tilt, heading = first.tilt_sigma_rad**2, first.heading_sigma_rad**2
    diagonal = np.einsum("ii->i", P)
    diagonal[TURN : TURN + 3] = (tilt, tilt, heading)
    diagonal[VELOCITY : VELOCITY + 3] = BEGIN_VELOCITY_SIGMA_M_S**2
    diagonal[GYR_BIAS : GYR_BIAS + 3] = params.gyr_bias_sigma**2
    diagonal[ACC_BIAS : ACC_BIAS + 3] = params.acc_bias_sigma**2
    diagonal[IMU_LAG] = lag_variance(params.imu_lag_s)
    diagonal[FILTER_LAG] = params.imu_lag_s**2
    diagonal[FILTER_ERROR : FILTER_ERROR + 3] = params.filter_error_m_s**2
    diagonal[RECEIVER_ERROR : RECEIVER_ERROR + 3] = params.receiver_error_m_s**2
    diagonal[FIELD_LAG] = first.field_lag_s**2
    diagonal[COMPASS_TURN] = first.compass_sigma_rad**2
    diagonal[HARD_IRON : HARD_IRON + 3] = iron**2
    by_iron_rad = iron * norm(first.turned_by_iron_1_gauss)
    # iron explains no more of the heading's error than there is: it may be limited
    correlation = min(1.0, first.heading_sigma_rad / max(by_iron_rad, TINY))
    together = correlation * iron**2 * np.array(first.turned_by_iron_1_gauss)
    P[TURN + 2, HARD_IRON : HARD_IRON + 3] = P[HARD_IRON : HARD_IRON + 3, TURN + 2] = together
    state = AidingState(
        estimate=AidingEstimate(
            q_ned_frd=q_ned_frd,
            velocity_ned_m_s=report.velocity_ned_m_s,
            gyr_bias_rad_s=gyr_bias,
            imu_lag_s=params.imu_lag_s,
            field_lag_s=first.field_lag_s,
        ),
        last=LastStep(
            gyr_rad_s=sample.gyr_rad_s,
            gyr_before_rad_s=sample.gyr_rad_s,
            force_ned_m_s2=rotate(q_ned_frd, sample.acc_m_s2),
            rate_rad_s=subtract(sample.gyr_rad_s, gyr_bias),
            dt_s=SPAN_S,
        ),
        sigma=first.sigma,
        acceleration_tilt=AccelerationTilt(
            ZERO_VEC3, report.velocity_ned_m_s, report.velocity_ned_m_s
        ),
        correction_cusum=CorrectionCusum(
            ZERO_VEC3, gyr_bias, 3.0 * params.gyr_bias_sigma**2, 0.0, 0.0
        ),
        bias_prior=BiasPrior(params.gyr_bias_sigma**2, params.acc_bias_sigma**2),
    )
    return state, P, new_velocity_history(add(state.last.force_ned_m_s2, GRAVITY_NED))


def blank_aiding(params: AidingParams) -> tuple[AidingState, Array, Array]:
    """The place of state, covariance and velocity history while there is no aiding."""
    state, P, velocity_history = begin(params, Start(IDENTITY, 0.0), NO_SAMPLE, NO_REPORT)
    return state, np.zeros_like(P), velocity_history


def inflate_covariance(state: AidingState, covariance: Array) -> tuple[AidingState, Array]:
    """State and covariance after reports or a field have been far off for long.

    If the attitude were the reason, its variance would be ``FAR`` times the assumed one, at most
    that of half a turn.
    """
    P = covariance.copy()
    turn = slice(TURN, TURN + 3)
    square = max(1.0, min(FAR, HALF_TURN_VARIANCE / float(P.diagonal()[turn].max())))
    P[turn, turn] *= square
    factor = sqrt(square)
    return state._replace(
        agreement=Agreements(*(each._replace(far_off_s=0.0) for each in state.agreement)),
        field=state.field._replace(far_off_s=0.0),
        sigma=Sigmas(*(factor * each for each in state.sigma)),
    ), P


def forget_biases(
    params: AidingParams, state: AidingState, covariance: Array
) -> tuple[AidingState, Array]:
    """State and covariance after a change of the IMU: its biases are as at the beginning."""
    P = covariance.copy()
    for first, sigma in ((GYR_BIAS, params.gyr_bias_sigma), (ACC_BIAS, params.acc_bias_sigma)):
        axes = slice(first, first + 3)
        P[axes, :] = P[:, axes] = 0.0
        P[axes, axes] = sigma**2 * np.eye(3)
    estimate = state.estimate._replace(gyr_bias_rad_s=ZERO_VEC3, acc_bias_m_s2=ZERO_VEC3)
    correction_cusum = state.correction_cusum._replace(
        bias_rad_s=ZERO_VEC3, least_variance=3.0 * params.gyr_bias_sigma**2
    )
    return state._replace(
        estimate=estimate,
        correction_cusum=correction_cusum,
        bias_prior=BiasPrior(params.gyr_bias_sigma**2, params.acc_bias_sigma**2),
        gyroscope_fault=GyroscopeFault(),
    ), P
