"""Consistency check of the aided attitude: e from measured vectors, and inflated variances.

The paper's filter follows the aided attitude, so its own e shows nothing. Here the specific force
of the last second is compared with the reported change of velocity, and the field without the
learnt hard iron with the place's. An unsensed turn, a bias that steps, a magnet or wrong velocities
show here before the covariance grows. The estimate changes only where the force is found wrong.

The mean difference, mostly noise and what slow streams miss, is learnt. Only a much larger one
inflates the variance.
"""

from math import atan2, hypot, sqrt
from math import exp as real_exp
from typing import NamedTuple

from estimator.aiding.correction_cusum import MOST_SQUARE
from estimator.aiding.force_fault import Before, Then, follow_field, is_no_turn, wrong_force
from estimator.aiding.search import Push, Window, extend_window, open_window, push_by
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import (
    NO_WRONG_FORCE,
    TURN,
    AidingEstimate,
    AidingParams,
    AidingState,
    Array,
    Report,
    Sigmas,
    WrongForce,
)
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import ACCELERATION_LASTS_S, LONG_S, REACH, SPAN_S
from estimator.conditioning.rate import slow_share
from estimator.conditioning.vertical.lowpass import approach
from estimator.conditioning.vertical.slow_acceleration import SCALE_ERROR
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD
from estimator.filter.kernel import follow_rate
from estimator.geometry.quaternion import (
    HALF_TURN_VARIANCE,
    conjugate,
    cross,
    dot,
    exp,
    multiply,
    norm,
    normalize,
    rotate,
    rotate_inverse,
    scale,
    square,
    subtract,
    unit,
)
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Sample, Vec3

# The share of the square beyond ``REACH`` times the mean difference that inflates the variance:
# an average lags behind an error that grows.
INFLATION_SHARE = 4.0


class Direction(NamedTuple):
    """A direction that was measured, in the gyro-propagated frame G, and where it should point."""

    g: Vec3 = (0.0, 0.0, 1.0)  # unit vector in G
    ned: Vec3 = (0.0, 0.0, 1.0)  # unit vector in NED
    share: float = 0.0  # confidence, 0 to 1; 0 while there is none


class Apart(NamedTuple):
    """How far measurements turn the attitude away from where it is."""

    mean_rad: Vec3  # averaged turn, NED
    mean_square: float  # mean square of that average, rad^2


class Consistency(NamedTuple):
    """What was measured lately, and how far from the attitude it lies."""

    q_g_frd: Quaternion = IDENTITY  # body to G, by the gyroscope free of the aiding's bias
    window: Window = Window()  # of the force, since a report opened it
    turned_rad: float = 0.0  # since then, every way
    by_receiver: bool = False  # whose reports open and close the window
    report_wait_s: float = 0.0  # since the last one of theirs
    force_wait_s: float = 0.0  # since a window was closed
    field_wait_s: float = 0.0  # since the last sample of the field
    force: Direction = Direction()
    field: Direction = Direction()
    tilt: Apart = Apart(ZERO_VEC3, LEAST_OFF_RAD**2)  # by the force
    heading: Apart = Apart(ZERO_VEC3, 4.0 * LEAST_OFF_RAD**2)  # by the field
    before: Before = Before()  # anything contradicted
    wrong_force: WrongForce = NO_WRONG_FORCE  # what this sample has shown to be wrong
    error: float = 0.0  # e of the published attitude against both directions, 0 to 1
    error_rate_1_s: float = 0.0  # its low-passed derivative


NEW_CONSISTENCY = Consistency()


@inlined
def average(apart: Apart, turn_rad: Vec3, time_s: float) -> Apart:
    """Average one more measured turn, over ``time_s``: a fault counts little."""
    mean_rad = approach(apart.mean_rad, turn_rad, time_s / (SPAN_S + time_s))
    usual = apart.mean_square
    newest = min(square(mean_rad), MOST_SQUARE * usual)
    return Apart(mean_rad, usual + time_s / (LONG_S + time_s) * (newest - usual))


@inlined
def inflation(apart: Apart) -> float:
    """The mean square (rad^2) that the excess adds to the attitude's."""
    return INFLATION_SHARE * max(0.0, square(apart.mean_rad) - REACH**2 * apart.mean_square)


@inlined
def inflated(sigma: Sigmas, consistency: Consistency) -> Sigmas:
    """The sigmas, inflated by what contradicts the attitude."""
    inclination, heading = sigma.inclination_rad, sigma.heading_rad
    return Sigmas(
        inclination_rad=(inclination * inclination + inflation(consistency.tilt)) ** 0.5,
        heading_rad=(heading * heading + inflation(consistency.heading)) ** 0.5,
    )


@inlined
def compare_sample(consistency: Consistency, aided: AidingState, sample: Sample) -> Consistency:
    """One sample's force added to the window; differences fade while no window is closed."""
    dt = sample.dt_s
    q_g_frd = normalize(multiply(consistency.q_g_frd, exp(scale(dt, aided.last.rate_rad_s))))
    ahead = exp(scale(aided.estimate.acc_lead_s, aided.last.rate_rad_s))
    felt = subtract(sample.acc_m_s2, aided.estimate.acc_bias_m_s2)
    force_g = rotate(multiply(q_g_frd, ahead), felt)
    tilt, force = consistency.tilt, consistency.force
    force_wait_s = consistency.force_wait_s + dt
    if force_wait_s > ACCELERATION_LASTS_S:
        keep = real_exp(-dt / SPAN_S)
        tilt = tilt._replace(mean_rad=scale(keep, tilt.mean_rad))
        force = force._replace(share=0.0)
    return consistency._replace(
        q_g_frd=q_g_frd,
        window=extend_window(consistency.window, force_g, dt),
        turned_rad=consistency.turned_rad + dt * norm(aided.last.rate_rad_s),
        report_wait_s=consistency.report_wait_s + dt,
        field_wait_s=consistency.field_wait_s + dt,
        force_wait_s=force_wait_s,
        force=force,
        tilt=tilt,
        wrong_force=NO_WRONG_FORCE,
    )


@inlined
def compare_report(
    params: AidingParams, consistency: Consistency, aided: AidingState, P: Array, report: Report
) -> Consistency:
    """A report may close a window of the force, and opens the next.

    A receiver's reports come first, as it knows nothing of the IMU; an autopilot's filter counts
    without them. ``P`` is the covariance of the aiding's errors.
    """
    estimate, is_receiver = aided.estimate, report.late_sigma_s > 0.0
    window = consistency.window
    is_silent = consistency.report_wait_s > ACCELERATION_LASTS_S
    if window.is_open and is_receiver != consistency.by_receiver and not (is_receiver or is_silent):
        return consistency
    lag_s = estimate.receiver_lag_s if is_receiver else estimate.filter_lag_s
    behind_s = report.ago_s + lag_s - estimate.imu_lag_s + estimate.acc_lead_s
    time_s = window.time_s - behind_s
    opened = open_window(window, report, behind_s)
    continues = window.is_open and is_receiver == consistency.by_receiver
    q_ned_g = multiply(estimate.q_ned_frd, conjugate(consistency.q_g_frd))
    now = Then(q_ned_g, estimate.gyr_bias_rad_s, 0.5 * (P[TURN, TURN] + P[TURN + 1, TURN + 1]))
    if continues and time_s < SPAN_S:
        return consistency._replace(report_wait_s=0.0)
    if continues and time_s <= ACCELERATION_LASTS_S:
        push = push_by(window, opened, report)
        seen, (north, east, down) = rotate(q_ned_g, push.force_g_m_s), push.change_ned_m_s
        expected = (north, east, down if report.has_vertical else seen[2])
        share = share_of(params, aided, push, time_s, consistency.turned_rad)
        force = Direction(unit(push.force_g_m_s), unit(expected), share)
        turn = scale(share, turn_between(seen, expected))
        is_followed, skidding = slow_share(aided.last.dt_s) <= 0.0, skids(params, estimate, report)
        consistency = consistency._replace(force=force)
        consistency = close_window(consistency, now, turn, time_s, is_followed, skidding)
    else:
        # nothing has agreed with this attitude yet
        now = now._replace(tilt_variance=HALF_TURN_VARIANCE)
        consistency = consistency._replace(before=consistency.before._replace(then=now, opened=now))
    return consistency._replace(
        window=opened, turned_rad=0.0, by_receiver=is_receiver, report_wait_s=0.0
    )


@inlined
def skids(params: AidingParams, estimate: AidingEstimate, report: Report) -> bool:
    """Whether a vehicle with wheels would go sideways: then the velocity is wrong."""
    velocity = report.velocity_ned_m_s
    across = abs(rotate_inverse(estimate.q_ned_frd, velocity)[1])
    return rolls(params) and across > max(0.5 * norm(velocity), params.filter_error_m_s)


@inlined
def close_window(
    consistency: Consistency, now: Then, turn: Vec3, time_s: float, is_followed: bool, skids: bool
) -> Consistency:
    """A window of ``time_s`` asks for a ``turn`` (rad, NED) of the attitude.

    The force is wrong where one window after the other asks for it, and the field shows that the
    vehicle has not made it; in a slow stream, which is not followed, it may have turned and back. A
    vehicle that ``skids`` since the first of them has wrong velocities.
    """
    before, tilt, found = consistency.before, consistency.tilt, NO_WRONG_FORCE
    level = (turn[0], turn[1], 0.0)
    usual = max(tilt.mean_square, before.then.tilt_variance)
    again = dot(level, tilt.mean_rad) > REACH**2 * usual
    has_skidded = skids or (before.has_skidded and inflation(tilt) > 0.0)
    is_seen = consistency.field_wait_s < SPAN_S and is_followed and not has_skidded
    before = before._replace(has_skidded=has_skidded)
    if inflation(tilt) <= 0.0:
        before = before._replace(then=before.opened, opened=now)
    elif again and is_seen and is_no_turn(before, consistency.field.g, now.q_ned_g, level):
        field = consistency.field
        found = wrong_force(before, now, level, field.g, field.ned)
    tilt = average(tilt, level, time_s)
    if found.variance > 0.0:
        tilt = tilt._replace(mean_rad=ZERO_VEC3)
    return consistency._replace(before=before, wrong_force=found, tilt=tilt, force_wait_s=0.0)


@inlined
def share_of(
    params: AidingParams, aided: AidingState, push: Push, time_s: float, turned_rad: float
) -> float:
    """How far a window counts: 1 at rest, little for one full of loops, where |force| is small.

    Its change of velocity may be off by the reports' error, by the force's change while they are
    late, and by ``SCALE_ERROR`` of the push for each radian turned, each compared with a second of
    gravity. A force that is shaken by more than the reports' error counts as much less.
    """
    error_m_s, late_s = params.filter_error_m_s, params.imu_lag_s
    pushed_m_s, swing = norm(push.force_g_m_s), norm(push.swing_g_m_s2)
    variance = error_m_s**2 + (late_s * swing) ** 2 + (SCALE_ERROR * turned_rad * pushed_m_s) ** 2
    expected = error_m_s * pushed_m_s / (STANDARD_GRAVITY_M_S2 * time_s)
    # three axes of white noise lie off the line through two readings by 18 times its square
    shaken_m_s = sqrt(aided.rough.knocked / 18.0 * aided.last.dt_s * time_s)
    return min(1.0, expected * expected / variance) * error_m_s / max(error_m_s, shaken_m_s)


@inlined
def turn_between(a: Vec3, b: Vec3) -> Vec3:
    """The shortest turn (rad) that takes the direction of a to that of b."""
    axis = cross(a, b)
    sine = norm(axis)
    if sine <= 0.0:
        return ZERO_VEC3
    return scale(atan2(sine, dot(a, b)) / sine, axis)


@inlined
def compare_field(consistency: Consistency, aided: AidingState, sample: Sample) -> Consistency:
    """A sample of the field, turned on by its age: it should point as the place's does.

    It counts as far as its strength and dip are those of the place.
    """
    estimate = aided.estimate
    E = estimate.earth_gauss
    horizontal = hypot(E[0], E[1])
    if horizontal <= NORM_SCALE * abs(E[2]):
        return consistency
    rate = subtract(sample.gyr_rad_s, estimate.gyr_bias_rad_s)
    then = exp(scale(-estimate.field_lag_s, rate))
    then = multiply(then, exp((0.0, 0.0, -estimate.compass_turn_rad)))
    m = rotate(then, subtract(sample.mag, estimate.hard_iron_gauss))
    F = rotate(estimate.q_ned_frd, m)
    share = aided.field.look.confidence
    off = share * atan2(F[0] * E[1] - F[1] * E[0], F[0] * E[0] + F[1] * E[1])
    wait = min(consistency.field_wait_s, 1.0)
    seen = Direction(unit(rotate(consistency.q_g_frd, m)), unit(E), share)
    before = consistency.before
    if inflation(consistency.tilt) <= 0.0:
        before = follow_field(before, seen.g, wait)
    heading = average(consistency.heading, (0.0, 0.0, off), wait)
    return consistency._replace(field_wait_s=0.0, field=seen, heading=heading, before=before)


@inlined
def compare(
    consistency: Consistency, q_ned_frd: Quaternion, dt: float, tau_s: float
) -> Consistency:
    """Add e of this attitude: sin^2 of half the angle to both directions, by their confidence.

    Its rate is low-passed with ``tau_s``.
    """
    field, force = consistency.field, consistency.force
    total = field.share + force.share
    e = 0.0
    if total > 0.0:
        q_ned_g = multiply(q_ned_frd, conjugate(consistency.q_g_frd))
        by_field = field.share * (1.0 - dot(rotate(q_ned_g, field.g), field.ned))
        by_force = force.share * (1.0 - dot(rotate(q_ned_g, force.g), force.ned))
        e = min(1.0, max(0.0, 0.5 * (by_field + by_force) / total))
    change = e - consistency.error
    return consistency._replace(
        error=e, error_rate_1_s=follow_rate(consistency.error_rate_1_s, change, dt, tau_s)
    )


@inlined
def watch(
    params: AidingParams,
    consistency: Consistency,
    aided: AidingState,
    P: Array,
    sample: Sample,
    report: Report,
) -> Consistency:
    """One sample with the report that belongs to it, after the aiding has learnt from both."""
    consistency = compare_sample(consistency, aided, sample)
    if report.given:
        consistency = compare_report(params, consistency, aided, P, report)
    if sample.has_mag:
        consistency = compare_field(consistency, aided, sample)
    return consistency
