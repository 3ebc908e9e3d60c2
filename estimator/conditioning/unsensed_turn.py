"""What tells an unsensed turn of the vehicle from noise, acceleration and magnets."""

from math import atan2, cos, pi

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import (
    Alarm,
    Calibration,
    ConditioningParams,
    Estimate,
    GravitySigns,
    GravityState,
    HeadingSigns,
    JumpSigns,
    MagneticState,
    RestState,
    TurnSigns,
    Two,
)
from estimator.geometry.quaternion import (
    add,
    angle_between_vectors,
    direction,
    norm,
    rotate,
    scale,
    square,
    subtract,
)
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3

HALF_TURN_VARIANCE = pi**2  # after a turn of gravity any heading is possible
# A heading this uncertain (rad, sigma) follows the field anyway: no alarm is needed.
UNKNOWN_HEADING_SIGMA = pi / 2.0
# If the quickly followed force is less than this share of the slow one, the vehicle falls or is
# in the middle of a turn: the force has no direction to compare.
LEAST_GRAVITY_SHARE = 0.4


# The two low-passes of the field in G (s), and the largest part of a jump that lies between them.
JUMP_QUICK_S = 0.1
JUMP_SLOW_S = 0.5
JUMP_SHARE = 0.535
# A reading whose norm is off by more than this share shows no turn: a spike, or a magnet. Both
# low-passes take it slowly, so that they part no further, and follow a field that stays another.
SPIKE_SHARE = 0.2
# Averaging (s) of how far a second's mean force usually is off the vertical.
WANDER_TAU_S = 10.0
# A field that turns by so many times what it usually does teaches no calibration.
SUSPECT_USUAL = 2.5
# Averaging (s) of how far they differ usually, in which a moment counts as no more than so many
# times that, and noise (rad): a jump is not usual because it has come.
JUMP_USUAL_S = 10.0
MOST_USUAL = 3.0
LEAST_USUAL_RAD = 0.005

# A field that is ahead of its low-pass by so many times what that is ahead of the slow one has
# come there at once.
SUDDEN_AHEAD = 2.0
SUDDEN_STILL = 0.5

# Averaging (s) of how far the field points elsewhere, for headings known this well (rad, sigma).
SCATTER_TAU_S = 20.0
KNOWN_HEADING_SIGMA = 0.2
# Averaging (s) of how far the low-passed force has another size than gravity.
UNEVEN_TAU_S = 15.0

# A mean field that has pointed elsewhere does so still until it is within this share of the angle
# that told it: meanwhile the heading creeps towards it.
STILL_OFF = 0.5

# A heading that was given up is remembered for so long (s); the field points to it again within
# ten degrees.
OTHER_HEADING_S = 60.0
# Of headings that are given up within so long (s) the first is remembered: a field that keeps
# turning takes the heading along in steps.
SAME_TURN_S = 10.0
SAME_HEADING_COS = 0.985

# A single sample is a sign of no more than this (s), however long its step: of slow streams
# several in a row have to agree.
LONGEST_SIGN_S = 0.15


@inlined
def duration_s(holds: bool, lasted_s: float, dt_s: float) -> float:
    """How long something has held."""
    return lasted_s + min(dt_s, LONGEST_SIGN_S) if holds else 0.0


@inlined
def points_beyond(params: ConditioningParams, horizontal: Two) -> bool:
    """Whether a field points further from north than ``turn_large_rad``."""
    north, east = horizontal
    if north > abs(east) and params.turn_large_rad >= 0.25 * pi:  # as nearly always
        return False
    return abs(atan2(east, north)) > params.turn_large_rad


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
    away = direction(n, e)
    least = params.turn_heading_rad * (STILL_OFF if state.off_s > 0.0 else 1.0)
    off = known and abs(away) > least and w > params.turn_confidence
    borne_s = borne_out(params, state, estimate.heading_rad - away, off, c, dt_s)
    if field.reference.is_new:  # the heading was that of a field that is not believed any more
        borne_s = 0.0
    b = dt_s / (SCATTER_TAU_S + dt_s) if estimate.covariance[9] < KNOWN_HEADING_SIGMA**2 else 0.0
    far = known and c > params.turn_large_confidence and points_beyond(params, horizontal)
    return HeadingSigns(
        mean_north=n,
        mean_east=e,
        mean_confidence=w,
        off_s=duration_s(off, state.off_s, dt_s),
        large_s=duration_s(far, state.large_s, dt_s),
        scatter=state.scatter + b * (away * away - state.scatter),
        borne_s=borne_s,
        other_rad=state.other_rad,
        other_s=max(0.0, state.other_s - dt_s),
    )


@inlined
def borne_out(
    params: ConditioningParams,
    state: HeadingSigns,
    by_field_rad: float,
    off: bool,
    confidence: float,
    dt_s: float,
) -> float:
    """For how long (s) the field has borne the heading out, less the time for which it has not.

    A heading that was given up lately and that the field points to again needs no more proof.
    """
    if not off:
        return min(state.borne_s + confidence * dt_s, params.heading_borne_s)
    again = state.other_s > 0.0 and cos(by_field_rad - state.other_rad) > SAME_HEADING_COS
    return 0.0 if again else max(0.0, state.borne_s - dt_s)


@inlined
def watch_gravity(
    params: ConditioningParams,
    state: GravitySigns,
    rest: RestState,
    gravity: GravityState,
    step: Two,
    decay: float,
    dt_s: float,
    doubt: float,
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
    falls = square(quick) <= LEAST_GRAVITY_SHARE**2 * square(f)
    off = 0.0 if falls else angle_between_vectors(quick, f)
    moving = off > params.turn_moving_rad
    a = dt_s / (WANDER_TAU_S + dt_s) if doubt == 0.0 else 0.0
    size = norm(f) / STANDARD_GRAVITY_M_S2 - 1.0
    b = dt_s / (min(UNEVEN_TAU_S, gravity.force.age_s) + dt_s)
    return GravitySigns(
        quiet_s=duration_s(quiet, state.quiet_s, dt_s),
        moving_s=duration_s(moving, state.moving_s, dt_s),
        levelled=(decay * state.levelled[0] + step[0], decay * state.levelled[1] + step[1]),
        wander=state.wander + a * (off * off - state.wander),
        uneven=state.uneven + b * (size * size - state.uneven),
    )


@inlined
def watch_field(
    state: JumpSigns,
    field_g: Vec3,
    turning: float,
    unseen: float,
    dt_s: float,
) -> JumpSigns:
    """Follow the field in G twice, quickly and slowly, and how far the two usually differ.

    In G the field of a place stands still, whatever the vehicle does and however it
    accelerates; beside steel it changes by a few degrees a second. A turn that the
    gyroscope has not shown turns it at once.
    """
    n = norm(field_g)
    if state.age_s == 0.0:
        return JumpSigns(field_g, field_g, n, n, 0.0, 0.0, turning, turning, unseen, 0.0, 0.0, dt_s)
    a, b = dt_s / (JUMP_QUICK_S + dt_s), dt_s / (JUMP_SLOW_S + dt_s)
    if abs(n - state.slow_norm) > SPIKE_SHARE * state.slow_norm:
        a = b
    quick = add(state.quick, scale(a, subtract(field_g, state.quick)))
    slow = add(state.slow, scale(b, subtract(field_g, state.slow)))
    turned = turn_of(quick, slow)
    c = dt_s / (min(JUMP_USUAL_S, state.age_s) + dt_s)
    apart = turned**2
    if state.age_s > JUMP_USUAL_S:
        apart = min(apart, MOST_USUAL**2 * (state.usual + LEAST_USUAL_RAD**2))
    return JumpSigns(
        quick=quick,
        slow=slow,
        quick_norm=state.quick_norm + a * (n - state.quick_norm),
        slow_norm=state.slow_norm + b * (n - state.slow_norm),
        apart_rad=turned,
        usual=state.usual + c * (apart - state.usual),
        usual_turning=state.usual_turning + c * (turning - state.usual_turning),
        turning=max(turning, state.turning + b * (turning - state.turning)),
        unseen=(1.0 - b) * state.unseen + unseen,
        seen_rad=state.seen_rad,
        ahead_rad=norm(subtract(field_g, state.quick)) / n if n > 0.0 else 0.0,
        age_s=min(state.age_s + dt_s, 1e6),
    )


@inlined
def jump_variance(
    params: ConditioningParams, state: JumpSigns, learnt: Calibration
) -> tuple[float, float]:
    """Variance (rad^2) to be added for a jump of the field, and the angle that it now accounts for.

    A jump is more than noise, than what the field usually does here, than what an unknown lag
    and own field make of turning, and than what slow samples miss. A magnet that turns the
    field changes its norm, too.
    """
    p = learnt.covariance
    own = p[9] + JUMP_SLOW_S**2 * (p[0] + p[4] + p[7])

    turned = state.apart_rad
    least = params.turn_jump_rad**2 + params.turn_jump_usual**2 * (state.usual + state.unseen)
    more = max(0.0, state.turning - state.usual_turning)
    by_turning = params.turn_jump_own**2 * own * state.turning
    if state.usual_turning > 0.0:
        seen = params.turn_jump_usual**2 * state.usual * more / state.usual_turning
        by_turning = min(by_turning, seen)
    least += by_turning
    if turned**2 < 0.25 * least:
        return 0.0, 0.0
    same = is_same_norm(params, state)
    if turned**2 < least or not same or turned <= state.seen_rad:
        return 0.0, state.seen_rad
    return (turned**2 - state.seen_rad**2) / JUMP_SHARE**2, turned


@inlined
def looks_turned(params: ConditioningParams, state: JumpSigns) -> bool:
    """Whether the field in G turns more than it usually does.

    What an unknown lag or own field makes of turning is part of the usual. After a turn that
    nobody has felt the calibration's means are of another attitude, and what has jumped would
    pass for the vehicle's own field along an axis that has told nothing of it before. A spike
    or a magnet, which change the norm, are no turn.
    """
    least = params.turn_jump_rad**2 + SUSPECT_USUAL**2 * (state.usual + state.unseen)
    return state.apart_rad**2 > least and is_same_norm(params, state)


@inlined
def is_same_norm(params: ConditioningParams, state: JumpSigns) -> bool:
    """Whether the field has its norm, as a magnet would not leave it."""
    return abs(state.quick_norm - state.slow_norm) < params.turn_jump_norm * state.slow_norm


@inlined
def is_near(params: ConditioningParams, field_norm: float, usual_norm: float) -> bool:
    """Whether the norm of a field is that of the place."""
    return abs(field_norm - usual_norm) < params.field_norm_scale * usual_norm


@inlined
def turn_of(u: Vec3, v: Vec3) -> float:
    """The angle between two vectors, rad; 0 where one has no direction."""
    return angle_between_vectors(u, v) if square(u) > 0.0 and square(v) > 0.0 else 0.0


@inlined
def alarm_of(
    params: ConditioningParams,
    state: TurnSigns,
    learnt: Calibration,
    usual_norm: float,
    is_doubted: bool,
) -> tuple[Alarm, float]:
    """Which signs have lasted for long enough, and the part of a jump that is told by now."""
    if not params.use_events:
        return Alarm(False, False, False, False, 0.0), 0.0
    jump, seen_rad = jump_variance(params, state.jump, learnt)
    least = params.turn_large_confidence
    ahead = SUDDEN_STILL if is_doubted else SUDDEN_AHEAD
    if state.jump.ahead_rad > ahead * state.jump.apart_rad:
        least = params.turn_jump_confidence
    if state.heading.mean_confidence < least or not is_near(
        params, state.jump.quick_norm, usual_norm
    ):
        jump = 0.0
    heading = state.heading.off_s > params.turn_heading_time_s
    heading = heading or state.heading.large_s > params.turn_large_time_s
    heading = heading and state.heading.borne_s <= 0.0
    gravity = state.gravity
    swing = gravity.levelled[0] ** 2 + gravity.levelled[1] ** 2
    return Alarm(
        heading=heading,
        quiet=gravity.quiet_s > params.turn_quiet_time_s,
        moving=gravity.moving_s > params.turn_moving_time_s,
        levelling=swing > params.turn_levelling_rad**2,
        jump=jump,
    ), seen_rad


@inlined
def reset_signs(
    state: TurnSigns, alarm: Alarm, seen_rad: float, heading_rad: float, given_up: bool
) -> TurnSigns:
    """After an alarm the signs start anew; the heading ``given_up`` is remembered."""
    before = state.jump
    jump = JumpSigns(
        before.quick,
        before.slow,
        before.quick_norm,
        before.slow_norm,
        before.apart_rad,
        before.usual,
        before.usual_turning,
        before.turning,
        before.unseen,
        seen_rad,
        before.ahead_rad,
        before.age_s,
    )
    heading, gravity = state.heading, state.gravity
    levelled = gravity.levelled
    if alarm.heading or alarm.quiet or alarm.moving or alarm.levelling:
        heading = HeadingSigns(
            mean_north=0.0,
            mean_east=0.0,
            mean_confidence=0.0,
            off_s=0.0,
            large_s=0.0,
            scatter=heading.scatter,
            borne_s=heading.borne_s,
            other_rad=heading.other_rad,
            other_s=heading.other_s,
        )
        levelled = (0.0, 0.0)
    if given_up:
        is_same = heading.other_s > OTHER_HEADING_S - SAME_TURN_S
        heading = HeadingSigns(
            mean_north=0.0,
            mean_east=0.0,
            mean_confidence=0.0,
            off_s=0.0,
            large_s=0.0,
            scatter=heading.scatter,
            borne_s=0.0,
            other_rad=heading.other_rad if is_same else heading_rad,
            other_s=OTHER_HEADING_S,
        )
    quiet_s = 0.0 if alarm.quiet else gravity.quiet_s
    moving_s = 0.0 if alarm.quiet or alarm.moving else gravity.moving_s
    return TurnSigns(
        heading, GravitySigns(quiet_s, moving_s, levelled, gravity.wander, gravity.uneven), jump
    )


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
