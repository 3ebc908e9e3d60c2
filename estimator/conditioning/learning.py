"""What the mean readings of one learning step teach: vertical, bias, field and signs."""

from math import atan2, cos, pi, sin
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.conditioning.averaging import follow_averaging
from estimator.conditioning.bias import lag, learn_at_rest, learn_in_motion, predict
from estimator.conditioning.calibration import learn_calibration, restart_means
from estimator.conditioning.clipping import forget_missed, missed_turn
from estimator.conditioning.doubt import (
    doubt_tilt,
    raise_doubt,
    release_doubt,
    share_of_force,
    steepness_of,
)
from estimator.conditioning.gather import NOTHING, means
from estimator.conditioning.gravity import (
    age_after_hole,
    down_of,
    level,
    observe_gravity,
    reseed_gravity,
    restart_gravity,
    rows_of,
)
from estimator.conditioning.heading import learn_heading, north_east
from estimator.conditioning.magnetic import (
    has_heading,
    observe_field,
    reference_norm,
    wait_for_field,
)
from estimator.conditioning.rest import observe_rest
from estimator.conditioning.spin import follow_spin
from estimator.conditioning.tilt import believe_force, least_share, lose_tilt, slowness, step_noise
from estimator.conditioning.types import (
    Alarm,
    Axes,
    CalibrationState,
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
    alarm_of,
    doubt_heading,
    gravity_at_rest,
    looks_turned,
    reset_signs,
    watch_field,
    watch_gravity,
    watch_heading,
)
from estimator.geometry.quaternion import dot, multiply, rotate, rotate_inverse, subtract
from estimator.types import Between, Vec3

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
    usual_norm, is_doubted = reference_norm(seen.magnetic), vertical.doubt.heading > 0.0
    alarm, seen_rad = alarm_of(params, signs, calibration.learnt, usual_norm, is_doubted)
    gravity, estimate = react(alarm, vertical.gravity, rest, seen.estimate, seen.horizontal)
    doubt, released = vertical.doubt, False
    heading_rad = estimate.heading_rad
    if alarm.jump > 0.0:
        doubt = raise_doubt(doubt, signs, alarm.jump, steepness_of(seen.magnetic))
    if mean.field_s > 0.0 and (doubt.heading > 0.0 or doubt.tilt > 0.0):
        doubt, estimate, released = release_doubt(
            params, doubt, estimate, seen.magnetic, seen.jump, seen.horizontal, dt
        )
    if is_doubted and doubt.heading == 0.0 and not released:
        seen_rad = pi  # the rest of that jump is a magnet's, too
    turned = alarm.heading or alarm.quiet or alarm.moving or alarm.levelling
    turned = turned or alarm.jump > 0.0 or (mean.field_s > 0.0 and looks_turned(params, seen.jump))
    if turned or clipped[0] + clipped[1] > MISSED_RAD**2:
        calibration = restart_means(calibration)
    if alarm.quiet or alarm.moving:
        tilt = lose_tilt(tilt)
    given_up = alarm.heading or released
    signs = reset_signs(signs, alarm, seen_rad, heading_rad, given_up)
    tells = not rest.resting and slowness(params, dt) == 0.0
    tells = tells and vertical.gravity.force.age_s > params.gravity_tau_s
    averaging = follow_averaging(
        params,
        state.averaging,
        vertical.gravity.force,
        vertical.spin,
        estimate,
        clipped[0] + clipped[1],
        tells,
        dt,
    )
    return ConditioningState(
        started=True,
        previous_gyr_rad_s=gyr,
        gathered=NOTHING,
        clipping=forget_missed(state.clipping),
        spin=vertical.spin,
        averaging=averaging,
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
        certainty=state.certainty,
        coefficients=k,
    )
