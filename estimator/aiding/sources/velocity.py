"""What a velocity report says about attitude, biases and the IMU's lag."""

from math import isfinite, sqrt
from typing import NamedTuple

import numpy as np

from estimator.aiding.covariance import expected_variance, learn, residual
from estimator.aiding.inertial import Prediction, unseen_share
from estimator.aiding.types import (
    IMU_LAG,
    REPORT_LAG,
    SIZE,
    VELOCITY,
    Agreement,
    AidingParams,
    AidingState,
    Array,
    Report,
    Scatter,
)
from estimator.compilation.compiled import inlined
from estimator.geometry.quaternion import add, rotate, scale, subtract
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3

FAR = 16.0  # squared innovation over its variance (4 sigma) of no ordinary report
CLIP = 25.0  # more than this says no more about the noise
INNOVATION_LIMIT = 3.0
SCALE_REPORTS = 100.0  # reports that the noise scale is the mean of
LARGEST_SCALE = 100.0
DOUBTFUL_SCALE = 30.0  # reports this noisy, or an attitude that makes them look so
COSINE_ELSEWHERE = 0.7  # the unaided gravity is 45 degrees off
INNOVATION_TAU_S = 60.0


class Step(NamedTuple):
    """What led to the prediction, and how old the data are that it and a report are made of."""

    dt: float
    force_before_ned_m_s2: Vec3  # at the sample ``dt`` before
    imu_lag_s: float
    report_lag_s: float  # counts where a report's age is uncertain


@inlined
def wait_for_report(state: Agreement, dt: float) -> Agreement:
    """Only time passes."""
    return Agreement(state.scatter, state.wait_s + dt, state.doubt_s)


@inlined
def mean_acceleration(now: Vec3, before: Vec3, ago_s: float, dt: float) -> Vec3:
    """Mean acceleration (NED) over the last ``ago_s``, the force linear between two samples."""
    share = min(1.0, 0.5 * ago_s / dt)
    force = add(now, scale(share, subtract(before, now)))
    return (force[0], force[1], force[2] + STANDARD_GRAVITY_M_S2)


@inlined
def observe_velocity(
    params: AidingParams,
    agreement: Agreement,
    now: Prediction,
    step: Step,
    report: Report,
    gravity_b: Vec3,
    x: Array,
) -> Agreement:
    """Three scalar updates (two without the vertical): report = v - a ago + a lag + error.

    The velocity at the report's own time is the one now less the acceleration
    since. The IMU's samples are ``lag`` old, so the prediction lags likewise.
    A report that is far off loosens the velocity, not the attitude: then the
    reports' origin has jumped. The noise scale follows the innovations.
    """
    P = now.covariance
    dt, force_before = step.dt, step.force_before_ned_m_s2
    noise_scale, innovation, reports = agreement.scatter
    wait = min(agreement.wait_s, 1.0)
    share = wait / (wait + INNOVATION_TAU_S) / 3.0
    accuracy = max(1.0, report.sigma_m_s / params.report_sigma_m_s)
    v = now.velocity_ned_m_s
    a = mean_acceleration(now.force_ned_m_s2, force_before, report.ago_s, dt)
    missed = scale(unseen_share(params, dt) * dt, subtract(now.force_ned_m_s2, force_before))
    behind = min(1.0, report.ago_s / dt)
    late = report.late_sigma_s > 0.0
    age_s = report.ago_s - step.imu_lag_s + (step.report_lag_s if late else 0.0)
    if late and P[REPORT_LAG, REPORT_LAG] == 0.0:
        P[REPORT_LAG, REPORT_LAG] = report.late_sigma_s**2
    elsewhere = rotate(now.q_ned_frd, gravity_b)[2] < COSINE_ELSEWHERE
    far = noise_scale > DOUBTFUL_SCALE and elsewhere
    for i in range(3 if report.has_vertical else 2):
        h = np.zeros(SIZE)
        h[VELOCITY + i] = 1.0
        if dt < params.lag_step_s:
            h[IMU_LAG] = a[i]
        if late:
            h[REPORT_LAG] = -a[i]
        off = report.velocity_ned_m_s[i] - v[i] + a[i] * age_s
        noise = noise_scale * (params.velocity_noise_m_s * accuracy) ** 2
        noise += behind * missed[i] * missed[i]
        left = residual(x, h, off)
        unit = left / sqrt(expected_variance(P, h, noise))
        square = unit * unit
        unit = max(-INNOVATION_LIMIT, min(INNOVATION_LIMIT, unit))
        reports += 1.0
        innovation += max(share, 1.0 / reports) * (unit * unit - innovation)
        noise_scale *= 1.0 + (min(square, CLIP) - 1.0) / (3.0 * SCALE_REPORTS)
        noise_scale = min(max(noise_scale, 1.0), LARGEST_SCALE)
        if square > FAR:
            P[VELOCITY + i, VELOCITY + i] += left * left
            far = True
        learn(P, x, h, off, noise)
    doubt_s = agreement.doubt_s + wait if far else max(0.0, agreement.doubt_s - wait)
    return Agreement(Scatter(noise_scale, innovation, reports), 0.0, doubt_s)


@inlined
def is_credible(params: AidingParams, state: AidingState) -> bool:
    """Whether to go on: reports came lately, and they and the field agree with the attitude.

    Neither sigma is a number once the covariance has gone wrong.
    """
    agreement = state.agreement
    if not isfinite(state.sigma.inclination_rad + state.sigma.heading_rad):
        return False
    doubt_s = max(agreement.doubt_s, state.field.doubt_s)
    return agreement.wait_s <= params.give_up_s and doubt_s <= params.doubt_s
