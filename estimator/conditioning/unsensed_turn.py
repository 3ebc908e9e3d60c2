"""What tells an unsensed turn of the vehicle from noise, acceleration and magnets."""

from math import atan2, pi, sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import (
    Alarm,
    ConditioningParams,
    Estimate,
    GravitySigns,
    GravityState,
    HeadingSigns,
    MagneticState,
    RestState,
    TurnSigns,
    Two,
)
from estimator.geometry.quaternion import angle_between_vectors, norm, rotate, scale
from estimator.types import Vec3

HALF_TURN_VARIANCE = pi**2  # after a turn of gravity any heading is possible
# A heading this uncertain (rad, sigma) follows the field anyway: no alarm is needed.
UNKNOWN_HEADING_SIGMA = pi / 2.0
# If the quickly followed force is less than this share of the slow one, the vehicle falls or is
# in the middle of a turn: the force has no direction to compare.
LEAST_GRAVITY_SHARE = 0.4


# A single sample is a sign of no more than this (s), however long its step: of slow streams
# several in a row have to agree.
LONGEST_SIGN_S = 0.15


@inlined
def duration_s(holds: bool, lasted_s: float, dt_s: float) -> float:
    """How long something has held."""
    return lasted_s + min(dt_s, LONGEST_SIGN_S) if holds else 0.0


@inlined
def watch_heading(
    params: ConditioningParams,
    state: HeadingSigns,
    estimate: Estimate,
    field: MagneticState,
    horizontal: Two,
    dt_s: float,
) -> HeadingSigns:
    """Look for a field that has its usual norm and dip, and keeps pointing elsewhere.

    A magnet that turns the field nearly always changes its norm or dip too, so
    its confidence falls; after a turn of the vehicle about the vertical both
    are as learnt. The means over time are of the field weighted by its
    confidence; a large residual at high confidence needs less time.
    """
    north, east = horizontal
    c = field.look.confidence
    a = dt_s / (params.turn_heading_tau_s + dt_s)
    n = state.mean_north + a * (c * north - state.mean_north)
    e = state.mean_east + a * (c * east - state.mean_east)
    w = state.mean_confidence + a * (c - state.mean_confidence)
    known = estimate.covariance[9] < UNKNOWN_HEADING_SIGMA**2
    off = known and abs(atan2(e, n)) > params.turn_heading_rad and w > params.turn_confidence
    far = known and abs(atan2(east, north)) > params.turn_large_rad
    far = far and c > params.turn_large_confidence
    return HeadingSigns(
        mean_north=n,
        mean_east=e,
        mean_confidence=w,
        off_s=duration_s(off, state.off_s, dt_s),
        large_s=duration_s(far, state.large_s, dt_s),
    )


@inlined
def watch_gravity(
    params: ConditioningParams,
    state: GravitySigns,
    rest: RestState,
    gravity: GravityState,
    step: Two,
    decay: float,
    dt_s: float,
) -> GravitySigns:
    """Look for gravity that keeps pulling elsewhere than the low-passed one in G.

    A quiet vehicle's gravity is known at once. Accelerations of a moving one
    reverse within a second or two and rarely exceed 1 g, a turn stays. And a
    levelling of many degrees has turned about the axis that was shortest, not
    the one the vehicle turned about, so its heading is wrong.
    """
    f = gravity.force.down.value
    quiet = False
    if rest.quiet:
        now = rotate(gravity.q_g_frd, scale(-1.0, rest.acc.value))
        quiet = angle_between_vectors(now, f) > params.turn_quiet_rad
    quick = gravity.force.quick
    moving = norm(quick) > LEAST_GRAVITY_SHARE * norm(f)
    moving = moving and angle_between_vectors(quick, f) > params.turn_moving_rad
    return GravitySigns(
        quiet_s=duration_s(quiet, state.quiet_s, dt_s),
        moving_s=duration_s(moving, state.moving_s, dt_s),
        levelled=(decay * state.levelled[0] + step[0], decay * state.levelled[1] + step[1]),
    )


@inlined
def alarm_of(params: ConditioningParams, state: TurnSigns) -> Alarm:
    """Which signs have lasted for long enough."""
    if not params.use_events:
        return Alarm(False, False, False, False)
    heading = state.heading.off_s > params.turn_heading_time_s
    heading = heading or state.heading.large_s > params.turn_large_time_s
    gravity = state.gravity
    swing = sqrt(gravity.levelled[0] ** 2 + gravity.levelled[1] ** 2)
    return Alarm(
        heading=heading,
        quiet=gravity.quiet_s > params.turn_quiet_time_s,
        moving=gravity.moving_s > params.turn_moving_time_s,
        levelling=swing > params.turn_levelling_rad,
    )


@inlined
def reset_signs(state: TurnSigns, alarm: Alarm) -> TurnSigns:
    """After an alarm the signs start anew."""
    heading, gravity = state.heading, state.gravity
    levelled = gravity.levelled
    if alarm.heading or alarm.quiet or alarm.moving or alarm.levelling:
        heading = HeadingSigns(
            mean_north=0.0, mean_east=0.0, mean_confidence=0.0, off_s=0.0, large_s=0.0
        )
        levelled = (0.0, 0.0)
    quiet_s = 0.0 if alarm.quiet else gravity.quiet_s
    moving_s = 0.0 if alarm.quiet or alarm.moving else gravity.moving_s
    return TurnSigns(heading, GravitySigns(quiet_s, moving_s, levelled))


@inlined
def doubt_heading(estimate: Estimate, variance: float) -> Estimate:
    """Raise the heading's variance, so that the next residuals correct it."""
    p = estimate.covariance
    return Estimate(
        estimate.bias_rad_s,
        estimate.heading_rad,
        (p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9] + variance),
    )


@inlined
def gravity_at_rest(rest: RestState, gravity: GravityState) -> Vec3:
    """A quiet vehicle's gravity in G."""
    return rotate(gravity.q_g_frd, scale(-1.0, rest.acc.value))
