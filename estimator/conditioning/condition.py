"""The conditioning stage: from one IMU sample to the paper's vectors."""

from math import atan2, cos, inf, sin, sqrt
from typing import NamedTuple

from estimator.compilation.compiled import compiled, inlined
from estimator.conditioning.bias import lag, learn_at_rest, learn_in_motion, predict
from estimator.conditioning.calibration import correct_field, learn_calibration, restart_means
from estimator.conditioning.clipping import forget_missed, missed_turn, watch_clipping
from estimator.conditioning.coefficients import coefficients
from estimator.conditioning.doubt import (
    doubt_tilt,
    raise_doubt,
    release_doubt,
    share_of_force,
    steepness_of,
)
from estimator.conditioning.gather import NOTHING, STEP_S, gather, means
from estimator.conditioning.gravity import (
    age_after_hole,
    down_of,
    level,
    observe_gravity,
    propagate_frame,
    reseed_gravity,
    restart_gravity,
    rows_of,
)
from estimator.conditioning.heading import learn_heading, north_east, wrap_angle
from estimator.conditioning.initial import initial_state
from estimator.conditioning.magnetic import (
    LEAST_HORIZONTAL,
    has_heading,
    observe_field,
    reference_norm,
    wait_for_field,
)
from estimator.conditioning.rate import (
    at_interval_end,
    following_weight,
    integration_rate,
)
from estimator.conditioning.rest import initial_rest, observe_rest
from estimator.conditioning.spin import follow_spin
from estimator.conditioning.tilt import (
    believe_force,
    initial_tilt,
    least_share,
    lose_tilt,
    slowness,
    step_noise,
)
from estimator.conditioning.types import (
    Alarm,
    Axes,
    CalibrationState,
    Conditioned,
    ConditioningParams,
    ConditioningState,
    Doubt,
    Estimate,
    Gathered,
    GravityState,
    HeadingSigns,
    JumpSigns,
    Lagged,
    MagneticState,
    RestState,
    Spin,
    StepNoise,
    TiltState,
    TurnSigns,
    Two,
)
from estimator.conditioning.unsensed_turn import (
    HALF_TURN_VARIANCE,
    OTHER_HEADING_S,
    alarm_of,
    doubt_heading,
    gravity_at_rest,
    looks_turned,
    reset_signs,
    watch_field,
    watch_gravity,
    watch_heading,
)
from estimator.geometry.quaternion import (
    conjugate,
    dot,
    exp,
    log,
    multiply,
    rotate,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.types import Between, Quaternion, Sample, Vec3

__all__ = ["condition", "initial_state"]

LEAST_DT_S = 1e-6
# Without a field for so long (s) there is no confidence in it any more.
FIELD_PATIENCE_S = 2.0
# Parts of the inclination's sigma (rad): at rest, for a force that varies by 1 g, per swing.
SIGMA_STEADY_RAD = 0.0052
SIGMA_UNSTEADY_RAD = 0.03
SIGMA_SWING = 0.5
# Squares of what the size of the force, off by a share of gravity, tells about the inclination and,
# times the dip's tangent, about the heading; and of what the field's scatter tells.
SIGMA_UNEVEN_SQUARE = 2.0
SIGMA_BENT_SQUARE = 0.6
SIGMA_SCATTER_SQUARE = 0.7
# The share by which a heading given up may still be right once another has been borne out.
STILL_RIVAL = 0.15
# Mean square of how far norm and dip are off, as shares and angles, even in an even field.
EVEN_SQUARE = 0.04**2
# The least, of a field that is a little bent everywhere.
SIGMA_FIELD_RAD = 0.01
# A heading whose own sigma is under this is known better than it says.
SIGMA_SETTLED_RAD = 0.1
# A turn missed in one step beyond which the calibration's means are of another attitude, rad.
MISSED_RAD = 0.01
# Weight of a field turned by a vertical that has just begun.
LEAST_SETTLED = 0.1


class Vertical(NamedTuple):
    """What a step's gyroscope and accelerometer have taught."""

    gravity: GravityState
    tilt: TiltState
    doubt: Doubt
    lagged: Lagged
    estimate: Estimate
    spin: Spin  # and the gyroscope's scale error
    swing: Two  # what levelling turned about north and east, rad
    turning: float  # squared rate, (rad/s)^2


class FieldStep(NamedTuple):
    """What a step's field has taught."""

    magnetic: MagneticState
    calibration: CalibrationState
    estimate: Estimate
    heading: HeadingSigns
    jump: JumpSigns
    horizontal: Two  # its north and east part, in its own unit


@inlined
def learn_bias(
    params: ConditioningParams,
    state: ConditioningState,
    estimate: Estimate,
    rest: RestState,
    lagged: Lagged,
    step: Two,
    unseen: float,
) -> Estimate:
    """The bias from rest, or from levelling once the vertical is known."""
    k = state.coefficients
    if rest.resting and params.use_rest:
        return learn_at_rest(params, k, estimate, rest)
    if params.use_motion_bias and state.gravity.force.age_s > params.gravity_tau_s:
        return learn_in_motion(params, k, estimate, lagged, step, unseen)
    return estimate


@inlined
def react(
    alarm: Alarm, gravity: GravityState, rest: RestState, estimate: Estimate, horizontal: Two
) -> tuple[GravityState, Estimate]:
    """After an unsensed turn: gravity anew, and as much doubt in the heading as it needs."""
    if alarm.quiet:
        gravity = level(reseed_gravity(gravity, gravity_at_rest(rest, gravity)))[0]
    elif alarm.moving:
        gravity = restart_gravity(gravity)
    if alarm.quiet or alarm.moving or alarm.levelling:
        estimate = doubt_heading(estimate, HALF_TURN_VARIANCE)
    elif alarm.heading:
        estimate = doubt_heading(estimate, atan2(horizontal[1], horizontal[0]) ** 2)
    return gravity, estimate


@inlined
def axes_of(gravity: GravityState, heading_rad: float) -> Axes:
    """Down and magnetic north in G."""
    q = gravity.q_6d_g
    north_6d = (cos(heading_rad), -sin(heading_rad), 0.0)
    return Axes(down_of(q), rotate_inverse(q, north_6d))


@inlined
def learn_vertical(
    params: ConditioningParams,
    state: ConditioningState,
    mean: Gathered,
    rest: RestState,
    noise: StepNoise,
    clipped: Two,
    usual_s: float,
) -> Vertical:
    """Gravity, the heading's prediction and the bias by one step's mean readings."""
    k = state.coefficients
    dt = mean.time_s
    slow = slowness(params, dt)
    least = least_share(params, k, state.gravity.force.age_s + dt)
    down_g, u = state.gravity.force.down.value, mean.gravity_g
    tilt, share = believe_force(params, state.tilt, noise, mean.gyr, down_g, u, dt, least)
    doubt, following = doubt_tilt(state.doubt, clipped[0]), slow
    if doubt.tilt > 0.0:
        doubt, doubt_share = share_of_force(params, doubt, state.signs.gravity.wander, dt)
        if doubt_share > max(least, slow * share):
            share, following = doubt_share, 1.0
    gravity = observe_gravity(params, k, state.gravity, u, share, following)
    gravity = age_after_hole(gravity, share, slow, dt, usual_s)
    gravity, step = level(gravity)
    rows = rows_of(multiply(gravity.q_6d_g, gravity.q_g_frd))
    rate = subtract(mean.gyr, state.estimate.bias_rad_s)
    turning = dot(rate, rate)
    missed = slow * noise.twist + clipped[1]
    estimate = predict(params, k, state.estimate, rows.down, turning, missed)
    b, age_s = estimate.bias_rad_s, gravity.force.age_s
    lagged = lag(params, k, state.lagged, rows, b, age_s, share, following)
    if following == slow:
        unseen = slow * noise.tilt / (dt * dt)
        estimate = learn_bias(params, state, estimate, rest, lagged, step, unseen)
    steady = following == 0.0 and age_s > params.gravity_tau_s and clipped[0] == 0.0
    spin = follow_spin(params, k, state.spin, gravity, rate, step, steady)
    # what levelling corrects of a slow step, or after a turn that was found, counts in variances
    swing = ((1.0 - following) * step[0], (1.0 - following) * step[1])
    return Vertical(gravity, tilt, doubt, lagged, estimate, spin, swing, turning)


@inlined
def learn_field(
    params: ConditioningParams,
    state: ConditioningState,
    mean: Gathered,
    missed: float,
    vertical: Vertical,
) -> FieldStep:
    """Calibration, confidence and heading by one step's mean field."""
    gravity, estimate = vertical.gravity, vertical.estimate
    rate = subtract(mean.gyr, state.estimate.bias_rad_s)
    signs, calibration = state.signs.heading, state.calibration
    since = state.magnetic.wait_s + mean.time_s
    field_6d = rotate(gravity.q_6d_g, mean.field_g)
    settled = max(LEAST_SETTLED, min(1.0, gravity.force.age_s / params.gravity_tau_s) ** 2)
    field = observe_field(params, state.magnetic, field_6d, since, settled)
    jump = watch_field(state.signs.jump, mean.field_g, vertical.turning, missed, since)
    n = reference_norm(field)
    if n > 0.0:
        rows = rows_of(gravity.q_g_frd)
        calibration = learn_calibration(params, calibration, rows, rate, mean.field_g, n, since)
    horizontal = (1.0, 0.0)
    if has_heading(field):
        horizontal = north_east(estimate.heading_rad, field_6d)
        signs = watch_heading(params, signs, estimate, field, horizontal, since)
        slow = slowness(params, mean.time_s)
        leaning = 0.5 * (slow * vertical.tilt.variance + vertical.doubt.tilt)
        estimate = learn_heading(params, estimate, field, horizontal, settled, since, leaning)
    return FieldStep(field, calibration, estimate, signs, jump, horizontal)


@inlined
def learn(
    params: ConditioningParams,
    state: ConditioningState,
    gyr: Vec3,
    between: Between,
    usual_s: float,
) -> ConditioningState:
    """One learning step on what was gathered; ``gyr`` is the last sample's.

    The step before was ``usual_s`` long.
    """
    k = state.coefficients
    mean = means(state.gathered)
    dt = mean.time_s
    rest = observe_rest(params, k.rest, state.rest, mean.gyr, mean.acc, dt)
    rate = subtract(mean.gyr, state.estimate.bias_rad_s)
    down = rotate_inverse(state.gravity.q_g_frd, state.axes.down_g)
    noise = step_noise(params, state.tilt, mean.gyr, rate, down, dt, between)
    clipped = missed_turn(state.clipping, down)
    vertical = learn_vertical(params, state, mean, rest, noise, clipped, usual_s)
    tilt = vertical.tilt
    seen = FieldStep(
        magnetic=wait_for_field(state.magnetic, dt),
        calibration=state.calibration,
        estimate=vertical.estimate,
        heading=state.signs.heading,
        jump=state.signs.jump,
        horizontal=(1.0, 0.0),
    )
    if mean.field_s > 0.0:
        missed = noise.tilt + noise.twist + clipped[0] + clipped[1]
        seen = learn_field(params, state, mean, missed, vertical)
    calibration = seen.calibration
    signs = TurnSigns(
        heading=seen.heading,
        gravity=watch_gravity(
            params,
            state.signs.gravity,
            rest,
            vertical.gravity,
            vertical.swing,
            k.levelling_decay,
            dt,
            vertical.doubt.tilt,
        ),
        jump=seen.jump,
    )
    alarm, seen_rad = alarm_of(params, signs, calibration.learnt, reference_norm(seen.magnetic))
    gravity, estimate = react(alarm, vertical.gravity, rest, seen.estimate, seen.horizontal)
    doubt, released = vertical.doubt, False
    heading_rad = estimate.heading_rad
    if alarm.jump > 0.0:
        doubt = raise_doubt(doubt, seen.jump, alarm.jump, steepness_of(seen.magnetic))
    if mean.field_s > 0.0 and (doubt.heading > 0.0 or doubt.tilt > 0.0):
        doubt, estimate, released = release_doubt(
            params, doubt, estimate, seen.magnetic, seen.jump, seen.horizontal, dt
        )
    turned = alarm.heading or alarm.quiet or alarm.moving or alarm.levelling
    turned = turned or alarm.jump > 0.0 or (mean.field_s > 0.0 and looks_turned(params, seen.jump))
    if turned or clipped[0] + clipped[1] > MISSED_RAD**2:
        calibration = restart_means(calibration)
    if alarm.quiet or alarm.moving:
        tilt = lose_tilt(tilt)
    given_up = alarm.heading or released
    signs = reset_signs(signs, alarm, seen_rad, heading_rad, given_up)
    return ConditioningState(
        started=True,
        previous_gyr_rad_s=gyr,
        gathered=NOTHING,
        clipping=forget_missed(state.clipping),
        spin=vertical.spin,
        gravity=gravity,
        tilt=tilt,
        rest=rest,
        estimate=estimate,
        lagged=vertical.lagged,
        magnetic=seen.magnetic,
        calibration=calibration,
        signs=signs,
        doubt=doubt,
        axes=axes_of(gravity, estimate.heading_rad),
        coefficients=k,
    )


@inlined
def ned_of_g(state: ConditioningState) -> Quaternion:
    """From G to north, east and down, as far as they are known."""
    half = 0.5 * state.estimate.heading_rad
    return multiply((cos(half), 0.0, 0.0, sin(half)), state.gravity.q_6d_g)


@inlined
def rate_by_attitudes(
    state: ConditioningState, rate: Vec3, before: Quaternion, slow: float, dt_s: float
) -> Vec3:
    """The rate that makes of the attitude before a slow step the one after it.

    exp(w' dt) = exp(w dt) exp(phi) with phi the step's correction seen from the
    body: what gyroscope and vectors together say the vehicle has turned.
    """
    correction = log(multiply(conjugate(before), ned_of_g(state)))
    phi = scale(slow, rotate_inverse(state.gravity.q_g_frd, correction))
    return scale(1.0 / dt_s, log(multiply(exp(scale(dt_s, rate)), exp(phi))))


@compiled
def condition(
    params: ConditioningParams, state: ConditioningState, sample: Sample
) -> tuple[ConditioningState, Conditioned]:
    """Take one sample, of which the field may be in any unit."""
    gyr, acc, mag = sample.gyr_rad_s, sample.acc_m_s2, sample.mag
    # Before the first sample there was no interval; what it tells counts as one step's.
    dt = max(sample.dt_s, LEAST_DT_S) if state.started else STEP_S
    previous = state.previous_gyr_rad_s if state.started else gyr
    turn = integration_rate(previous, gyr, dt, params.averaged_samples)
    if sample.between.given:
        turn = sample.between.turn_rad_s
    rate = subtract(subtract(turn, state.estimate.bias_rad_s), state.spin.drift_rad_s)
    if params.averaged_samples:
        acc = at_interval_end(acc, gyr, dt)
        mag = at_interval_end(mag, gyr, dt)
    if sample.has_mag:
        mag = correct_field(mag, rate, state.calibration.learnt)
    gravity = propagate_frame(state.gravity, rate, dt)
    corrected = Sample(
        gyr_rad_s=gyr,
        acc_m_s2=acc,
        mag=mag,
        has_mag=sample.has_mag,
        dt_s=dt,
        between=sample.between,
    )
    gathered = gather(state.gathered, gravity.q_g_frd, corrected)
    first = not state.started
    k = state.coefficients
    usual_s = k.dt_s
    due = first or gathered.time_s >= STEP_S
    clipping = watch_clipping(state.clipping, state.previous_gyr_rad_s, gyr, dt)
    if due and gathered.time_s != k.dt_s:
        k = coefficients(params, gathered.time_s)
    rest, tilt = state.rest, state.tilt
    if first:
        rest = initial_rest(gyr, acc)
        tilt = initial_tilt(gyr, scale(-1.0, rotate(gravity.q_g_frd, acc)))
    state = ConditioningState(
        started=True,
        previous_gyr_rad_s=gyr,
        gathered=gathered,
        clipping=clipping,
        spin=state.spin,
        gravity=gravity,
        tilt=tilt,
        rest=rest,
        estimate=state.estimate,
        lagged=state.lagged,
        magnetic=state.magnetic,
        calibration=state.calibration,
        signs=state.signs,
        doubt=state.doubt,
        axes=state.axes,
        coefficients=k,
    )
    if due:
        before = state
        state = learn(params, before, gyr, sample.between, usual_s)
        slow = 0.0 if first else slowness(params, dt)
        if slow > 0.0:
            rate = rate_by_attitudes(state, rate, ned_of_g(before), slow, dt)
    return state, result_of(params, state, rate)


@inlined
def sigma_inclination(params: ConditioningParams, state: ConditioningState) -> float:
    """Angle (rad) that 68 % of the inclination errors lie under.

    A sensor's own, what unsteady force adds, how far levelling has moved the vertical lately,
    which tells a lasting acceleration, and how far the low-passed force has another size than
    gravity: what an accelerometer's error or an acceleration adds along the vertical it adds
    across as well, about both axes. Of slow streams it is the variance that the vertical has by
    its own reckoning.
    """
    signs = state.signs.gravity
    swing_north, swing_east = signs.levelled
    swing = swing_north * swing_north + swing_east * swing_east
    fast = SIGMA_UNSTEADY_RAD**2 * state.gravity.force.unsteady + SIGMA_SWING**2 * swing
    slow = slowness(params, state.coefficients.dt_s)
    fast += SIGMA_UNEVEN_SQUARE * signs.uneven
    known = SIGMA_STEADY_RAD**2 + state.doubt.tilt
    return sqrt(known + (1.0 - slow) * fast + slow * state.tilt.variance)


@inlined
def rival(params: ConditioningParams, state: ConditioningState) -> float:
    """Variance (rad^2) for another heading that may be the right one.

    Before a field is believed that is where it points, as one that looks as expected, or another
    one that lasts; afterwards it is the heading given up.
    """
    signs, reference = state.signs.heading, state.magnetic.reference
    seen_s = reference.other.seen_s
    by_other = 0.0
    if seen_s > 0.0:
        field_6d = rotate(state.gravity.q_6d_g, state.signs.jump.slow)
        north, east = north_east(state.estimate.heading_rad, field_6d)
        by_other = seen_s / (seen_s + reference.borne_s) * atan2(east, north) ** 2
    unborne = 1.0 - signs.borne_s / params.heading_borne_s
    if signs.off_s > 0.0:
        away = atan2(signs.mean_east, signs.mean_north)
        return max(unborne * away * away, by_other)
    away = wrap_angle(signs.other_rad - state.estimate.heading_rad)
    share = max(unborne, STILL_RIVAL) * signs.other_s / OTHER_HEADING_S
    return max(share * away * away, by_other)


@inlined
def sigma_heading(params: ConditioningParams, state: ConditioningState) -> float:
    """Angle (rad) that 68 % of the heading errors lie under.

    The variance P takes the field's error for white: it is larger than the error of a good
    sensor and too small beside steel, where the error lasts. So what little of P is left
    after long counts as P^2/(P + P_1) only, but for slow streams, whose P is what they miss. To
    it comes what the field is seen to scatter, and what the accelerometer's error, seen
    likewise, bends a steep field. A field whose norm and dip are off by more than is usual is off
    across, too.
    """
    p = state.estimate.covariance[9]
    reference = state.magnetic.reference
    h = max(reference.horizontal, LEAST_HORIZONTAL * abs(reference.down))
    steep = (reference.down / h) ** 2 if h > 0.0 else 0.0
    signs = state.signs
    lasting = SIGMA_SCATTER_SQUARE * signs.heading.scatter + rival(params, state)
    bent = steep * (SIGMA_BENT_SQUARE * signs.gravity.uneven + 0.5 * state.doubt.tilt)
    lasting += SIGMA_FIELD_RAD**2 + bent + state.doubt.heading
    lasting += (1.0 + steep) * max(0.0, reference.uneven - EVEN_SQUARE)
    slow = slowness(params, state.coefficients.dt_s)
    own = p * (slow + (1.0 - slow) * p / (p + SIGMA_SETTLED_RAD**2))
    return sqrt(own + lasting)


@inlined
def result_of(params: ConditioningParams, state: ConditioningState, rate: Vec3) -> Conditioned:
    """The result for the filter and the publisher."""
    q = state.gravity.q_g_frd
    field = state.magnetic
    known = has_heading(field)
    weight = following_weight(slowness(params, state.coefficients.dt_s), state.coefficients.dt_s)
    return Conditioned(
        rate_rad_s=rate,
        bias_rad_s=state.estimate.bias_rad_s,
        gravity_b=rotate_inverse(q, state.axes.down_g),
        magnetic_b=rotate_inverse(q, state.axes.north_g),
        weight=weight,
        has_heading=known,
        gravity_confidence=1.0 / (1.0 + state.gravity.force.unsteady),
        magnetic_confidence=field.look.confidence if field.wait_s < FIELD_PATIENCE_S else 0.0,
        sigma_inclination_rad=sigma_inclination(params, state),
        sigma_heading_rad=sigma_heading(params, state) if known else inf,
    )
