"""What a velocity report shows about attitude, biases and the IMU's lag."""

from math import cos, isfinite, sqrt

import numpy as np

from estimator.aiding.covariance import expected_variance, learn, residual
from estimator.aiding.inertial import GRAVITY_NED, Prediction, newest_deviation
from estimator.aiding.search import UNKNOWN_RAD
from estimator.aiding.types import (
    FILTER_ERROR,
    FILTER_LAG,
    IMU_LAG,
    RECEIVER_ERROR,
    RECEIVER_LAG,
    SIZE,
    TURN,
    VELOCITY,
    Agreement,
    Agreements,
    AidingParams,
    AidingState,
    Array,
    Report,
    Scatter,
)
from estimator.aiding.velocity_history import look_back
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import (
    CONFIRM_S,
    FAR,
    LONG_S,
    LONGEST_STEP_S,
    REACH,
    SPAN_S,
    USUAL_S,
)
from estimator.geometry.quaternion import rotate, scale, subtract
from estimator.types import Vec3

# The attitude is given up after reports were far off for so long, s. Small: good attitudes beside
# an accelerometer's offset are lost; large: one that is upside down lasts.
DISAGREEMENT_S = 1.5
# Largest normalised squared innovation for the noise scale: one wild report must not spoil it.
CLIP = 25.0
# The noise scale is a mean over about this many reports, and itself at most as large.
SCALE_REPORTS = 100.0
# The noise scale of a receiver's reports may also fall, to this: no IMU has smoothed them.
LEAST_RECEIVER_SCALE = 0.1


@inlined
def wait_for_reports(agreement: Agreements, dt: float) -> Agreements:
    """The agreements ``dt`` later, without a report since."""
    return Agreements(wait_longer(agreement.by_filter, dt), wait_longer(agreement.by_receiver, dt))


@inlined
def wait_longer(agreement: Agreement, dt: float) -> Agreement:
    """The agreement of one source ``dt`` later.

    How well reports agreed before a hole shows nothing of the attitude after it.
    """
    scatter = agreement.scatter
    if dt > SPAN_S:
        scatter = scatter._replace(innovation=1.0, reports=min(scatter.reports, 1.0))
    return Agreement(scatter, agreement.wait_s + dt, agreement.far_off_s)


@inlined
def take_report(
    params: AidingParams,
    agreement: Agreements,
    now: Prediction,
    dt: float,
    report: Report,
    gravity_b: Vec3,
    x: Array,
) -> Agreements:
    """Three scalar updates (two without the vertical): report = v(then) + slow error + noise.

    v(then) is the velocity now less what the velocity history has gained since. A turn t of the
    attitude changes that by t x (force since), so a late report shows less of it. A report that is
    far off inflates the variance of its source's error, or of the velocity if that is the only
    source, but not of the attitude: its origin has jumped. The noise scale follows the innovations.
    """
    P, estimate = now.covariance, now.estimate
    by_filter, by_receiver = agreement
    is_receiver = report.late_sigma_s > 0.0
    if is_receiver:
        own, other, error_m_s = by_receiver, by_filter, estimate.receiver_error_m_s
        lag_s, error_at, lag_at = estimate.receiver_lag_s, RECEIVER_ERROR, RECEIVER_LAG
        sigma, least = params.receiver_noise_m_s, LEAST_RECEIVER_SCALE
    else:
        own, other, error_m_s = by_filter, by_receiver, estimate.filter_error_m_s
        lag_s, error_at, lag_at = estimate.filter_lag_s, FILTER_ERROR, FILTER_LAG
        sigma, least = params.filter_noise_m_s, 1.0
    scatter, units = own.scatter, np.zeros(3)
    wait = min(own.wait_s, 1.0)
    share = wait / (wait + USUAL_S) / 3.0
    if is_receiver and scatter.reports == 0.0:  # the first one gives how late it may be
        P[lag_at, lag_at] = report.late_sigma_s**2
        x[lag_at] = report.late_sigma_s
    age_s = report.ago_s + lag_s - estimate.imu_lag_s + estimate.acc_lead_s
    gained_m_s, acceleration = look_back(now.velocity_history, age_s)
    pushed = subtract(gained_m_s, scale(age_s, GRAVITY_NED))
    behind = min(1.0, report.ago_s / dt)
    aliasing = scale(params.integration_noise * dt * behind, newest_deviation(now.velocity_history))
    sigma *= max(1.0, report.sigma_m_s / params.report_sigma_m_s)
    loose_at = VELOCITY if other.wait_s >= SPAN_S else error_at
    elsewhere = rotate(estimate.q_ned_frd, gravity_b)[2] < cos(UNKNOWN_RAD)
    # very noisy reports, or an attitude that makes them look so: then the unaided one disagrees
    far = scatter.noise_scale > FAR and elsewhere
    for i in range(3 if report.has_vertical else 2):
        h = velocity_row(error_at, lag_at, i, pushed, acceleration, dt)
        then = estimate.velocity_ned_m_s[i] - gained_m_s[i]
        off = report.velocity_ned_m_s[i] - error_m_s[i] - then
        noise = scatter.noise_scale * sigma * sigma + aliasing[i] * aliasing[i]
        left = residual(x, h, off)
        # rounding may take an attitude as good as unknown below nothing
        unit = left / sqrt(max(expected_variance(P, h, noise), noise))
        units[i] = max(-REACH, min(REACH, unit))
        scatter = follow_scatter(scatter, unit, scatter.latest[i], share, least)
        if unit * unit > FAR:
            P[loose_at + i, loose_at + i] += left * left
            far = True
        learn(P, x, h, off, noise)
    far_off_s = own.far_off_s + wait if far else max(0.0, own.far_off_s - wait)
    own = Agreement(scatter._replace(latest=(units[0], units[1], units[2])), 0.0, far_off_s)
    return Agreements(by_filter, own) if is_receiver else Agreements(own, by_receiver)


@inlined
def velocity_row(
    error_at: int, lag_at: int, i: int, pushed: Vec3, acceleration: Vec3, dt: float
) -> Array:
    """How the errors show in the axis ``i`` (NED) of a report.

    Its source's slow error begins at ``error_at`` among them, and its lag stands at ``lag_at``.
    ``pushed`` (m/s) is what the force has added since the report's time, ``acceleration`` (m/s^2)
    the vehicle's at that time.
    """
    h = np.zeros(SIZE)
    h[VELOCITY + i] = 1.0
    h[error_at + i] = 1.0
    j, k = (i + 1) % 3, (i + 2) % 3
    h[TURN + j] = -pushed[k]  # minus the component of turn x pushed
    h[TURN + k] = pushed[j]
    if dt < LONGEST_STEP_S:
        h[IMU_LAG] = acceleration[i]
    h[lag_at] = -acceleration[i]
    return h


@inlined
def follow_scatter(
    state: Scatter, unit: float, before: float, share: float, least: float
) -> Scatter:
    """The scatter after an axis's innovation of ``unit`` expected sigmas.

    The axis's previous one was ``before``. ``share`` is the newest one's in the means, ``least``
    the smallest scale of the noise.
    """
    near = max(-REACH, min(REACH, unit))
    reports = state.reports + 1.0
    newest = max(share, 1.0 / reports)
    grown = state.noise_scale * (1.0 + (min(unit * unit, CLIP) - 1.0) / (3.0 * SCALE_REPORTS))
    return Scatter(
        noise_scale=min(max(grown, least), SCALE_REPORTS),
        innovation=state.innovation + newest * (near * near - state.innovation),
        reports=reports,
        latest=state.latest,
        together=state.together + newest * (near * before - state.together),
    )


@inlined
def is_credible(state: AidingState) -> bool:
    """Whether to go on: reports came lately, and they and the field agree with the attitude.

    Once the covariance has gone wrong, neither sigma is a number.
    """
    by_filter, by_receiver = state.agreement
    if not isfinite(state.sigma.inclination_rad + state.sigma.heading_rad):
        return False
    wait_s = min(by_filter.wait_s, by_receiver.wait_s)
    latest = by_filter if by_filter.wait_s < by_receiver.wait_s else by_receiver
    far_off_s = latest.far_off_s
    if max(by_filter.wait_s, by_receiver.wait_s) < SPAN_S:
        far_off_s = min(by_filter.far_off_s, by_receiver.far_off_s)  # one is enough
    if state.field.far_off_s > CONFIRM_S or state.wheels.contradict:
        return False
    return wait_s <= LONG_S and far_off_s <= DISAGREEMENT_S
