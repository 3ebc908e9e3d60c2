"""The conditioning stage: from one IMU sample to the paper's vectors."""

from math import cos, inf, pi, sin, sqrt
from typing import NamedTuple

from estimator.compiled import compiled
from estimator.conditioning.bias import learn_at_rest, learn_in_motion, predict, smooth_rows
from estimator.conditioning.events import (
    gravity_turned,
    heading_forgotten,
    heading_turned,
    levelled,
    reseeded,
    size,
)
from estimator.conditioning.gravity import DOWN, level, observe_gravity, propagate_frame
from estimator.conditioning.heading import (
    field_north_east,
    has_heading,
    learn_heading,
    residual,
)
from estimator.conditioning.lowpass import low_pass
from estimator.conditioning.magnetic import observe_field, without_field
from estimator.conditioning.rate import SLOW_SAMPLE_S, at_interval_end, integration_rate
from estimator.conditioning.rest import observe_rest
from estimator.conditioning.types import (
    BiasState,
    Coefficients,
    Conditioned,
    ConditioningParams,
    ConditioningState,
    EventState,
    GravityState,
    LowPass,
    MagneticState,
    RestState,
    Smooth,
)
from estimator.quaternion import multiply, rotate, rotate_inverse, subtract
from estimator.types import IDENTITY, Vec3

BIAS_WALK_TIME_S = 100.0  # the time that ``bias_walk_rad_s`` refers to
LEAST_DT_S = 1e-6
UNKNOWN_HEADING_VARIANCE = (
    100.0 * pi / 18.0
) ** 2  # 1000 degrees: the first field sets the heading


def initial_state(params: ConditioningParams) -> ConditioningState:
    """The state before the first sample."""
    zero = (0.0, 0.0, 0.0)
    rest = Smooth(zero, zero)
    v = params.bias_initial_sigma_rad_s**2
    no_pass = LowPass(0.0, 0.0, 0.0)
    return ConditioningState(
        Coefficients(0.0, no_pass, no_pass, 0.0, 0.0, 0.0, 0.0, 0.0),
        zero,
        False,
        RestState(rest, rest, False, 0.0, False),
        GravityState(IDENTITY, IDENTITY, Smooth(zero, zero), (0.0, 0.0), 0.0),
        BiasState(
            zero,
            0.0,
            (v, 0.0, 0.0, 0.0, v, 0.0, 0.0, v, 0.0, UNKNOWN_HEADING_VARIANCE),
            (0.0,) * 6,
            (0.0,) * 6,
            (0.0, 0.0),
            (0.0, 0.0),
        ),
        MagneticState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False),
        EventState(0.0, 0.0, (0.0, 0.0)),
    )


@compiled
def coefficients(params: ConditioningParams, dt_s: float) -> Coefficients:
    """What depends on the time step only.

    With the random walk V dt a step, the noise w = P^2/(V dt) + P of a
    measurement makes P the steady variance, whatever the step.
    """
    walk = params.bias_walk_rad_s**2 * dt_s / BIAS_WALK_TIME_S
    at_rest = params.bias_rest_sigma_rad_s**2
    moving = params.bias_motion_sigma_rad_s**2
    return Coefficients(
        dt_s,
        low_pass(params.rest_tau_s, dt_s),
        low_pass(params.gravity_tau_s, dt_s),
        0.0,
        walk,
        at_rest * at_rest / walk + at_rest,
        moving * moving / walk + moving,
        params.heading_noise_rad2_s * dt_s / params.heading_tau_s**2,
    )


@compiled
def started(state: ConditioningState, gyr: Vec3, acc: Vec3) -> ConditioningState:
    """The first sample starts the low-passes where the sensors are."""
    zero = (0.0, 0.0, 0.0)
    rest = RestState(Smooth(gyr, zero), Smooth(acc, zero), False, 0.0, False)
    return ConditioningState(
        state.coefficients, gyr, True, rest, state.gravity, state.bias, state.magnetic, state.event
    )


class Rows(NamedTuple):
    """North, east and down of the 6D frame, seen from the body: the rows of R6."""

    north: Vec3
    east: Vec3
    down: Vec3


class Seen(NamedTuple):
    """What one field sample changed."""

    field: MagneticState
    bias: BiasState
    heading_s: float


class Alarm(NamedTuple):
    """Which sign of an unsensed turn went off, and how far the others are."""

    heading: bool
    reseed: bool
    swung: bool
    event: EventState


@compiled
def learn_bias(
    params: ConditioningParams,
    k: Coefficients,
    state: BiasState,
    rest: RestState,
    gravity: GravityState,
    rows: Rows,
    dt_s: float,
) -> BiasState:
    """Predict, then learn the bias from rest or from levelling."""
    bias = predict(params, k, state, rows.down, dt_s)
    bias = smooth_rows(params, k, bias, gravity, rows.north, rows.east, dt_s)
    if gravity.age_s <= params.gravity_tau_s:
        return bias
    if rest.resting and params.use_rest:
        return learn_at_rest(params, k, bias, rest)
    if params.use_motion_bias:
        return learn_in_motion(params, k, bias, gravity)
    return bias


@compiled
def learn_field(
    params: ConditioningParams,
    state: ConditioningState,
    bias: BiasState,
    field_6d: Vec3,
    dt_s: float,
) -> Seen:
    """Judge the field, then let it correct the heading."""
    since = state.magnetic.wait_s + dt_s
    field = observe_field(params, state.magnetic, field_6d, dt_s)
    if not has_heading(field):
        return Seen(field, bias, 0.0)
    north, east = field_north_east(bias.heading_rad, field_6d)
    heading_s = heading_turned(params, state.event, bias, field, north, east, since)
    off = residual(field, north, east)
    return Seen(field, learn_heading(params, bias, field, off, since), heading_s)


@compiled
def watch(
    params: ConditioningParams,
    state: EventState,
    rest: RestState,
    gravity: GravityState,
    heading_s: float,
    dt_s: float,
) -> Alarm:
    """Look at the three signs of an unsensed turn; one that goes off starts anew."""
    quiet_s = gravity_turned(params, state, rest, gravity, dt_s)
    swing = levelled(params, state, gravity, dt_s)
    heading = params.use_events and heading_s > params.turn_heading_time_s
    reseed = params.use_events and quiet_s > params.turn_quiet_time_s
    swung = params.use_events and size(swing) > params.turn_levelling_rad
    if heading:
        heading_s = 0.0
    if reseed:
        quiet_s = 0.0
    if reseed or swung:
        swing = (0.0, 0.0)
    return Alarm(heading, reseed, swung, EventState(heading_s, quiet_s, swing))


@compiled
def react(
    alarm: Alarm,
    gravity: GravityState,
    rest: RestState,
    bias: BiasState,
    dt_s: float,
) -> tuple[GravityState, BiasState]:
    """After an unsensed turn: gravity anew if quiet, and a heading that may be anything."""
    if alarm.reseed:
        gravity = level(reseeded(gravity, rest), dt_s)
    if alarm.heading or alarm.reseed or alarm.swung:
        bias = heading_forgotten(bias)
    return gravity, bias


@compiled
def condition(
    params: ConditioningParams,
    state: ConditioningState,
    gyr: Vec3,
    acc: Vec3,
    mag: Vec3,
    has_mag: bool,
    dt_s: float,
) -> tuple[ConditioningState, Conditioned]:
    """Take one sample (FRD; rad/s, m/s^2, any field unit) that came ``dt_s`` after the last one."""
    dt = max(dt_s, LEAST_DT_S)
    if not state.started:
        state = started(state, gyr, acc)
    k = state.coefficients
    if k.dt_s != dt:
        k = coefficients(params, dt)

    turn = integration_rate(state.previous_gyr_rad_s, gyr, dt, params.averaged_samples)
    if params.averaged_samples and dt >= SLOW_SAMPLE_S:
        acc = at_interval_end(acc, gyr, dt)
        mag = at_interval_end(mag, gyr, dt)

    rest = observe_rest(params, k.rest, state.rest, gyr, acc, dt)
    rate = subtract(turn, state.bias.bias_rad_s)
    gravity = propagate_frame(state.gravity, rate, dt)
    gravity = observe_gravity(params, k.gravity, gravity, acc, dt)

    q_6d = multiply(gravity.q_6d_g, gravity.q_g_frd)
    row1 = rotate_inverse(q_6d, (1.0, 0.0, 0.0))
    row2 = rotate_inverse(q_6d, (0.0, 1.0, 0.0))
    row3 = rotate_inverse(q_6d, DOWN)

    bias = learn_bias(params, k, state.bias, rest, gravity, Rows(row1, row2, row3), dt)
    seen = Seen(without_field(state.magnetic, dt), bias, state.event.heading_s)
    if has_mag:
        seen = learn_field(params, state, bias, rotate(q_6d, mag), dt)
    alarm = watch(params, state.event, rest, gravity, seen.heading_s, dt)
    gravity, bias = react(alarm, gravity, rest, seen.bias, dt)
    field = seen.field
    if alarm.reseed:
        q_6d = multiply(gravity.q_6d_g, gravity.q_g_frd)

    d = bias.heading_rad
    declination = params.declination_rad
    known = field.known and has_heading(field)
    out = Conditioned(
        rate,
        bias.bias_rad_s,
        rotate_inverse(q_6d, DOWN),
        DOWN,
        rotate_inverse(q_6d, (cos(d), -sin(d), 0.0)),
        (cos(declination), sin(declination), 0.0),
        1.0,
        1.0 if known else 0.0,
        1.0,
        field.confidence if has_mag else 0.0,
        0.0,
        sqrt(bias.covariance[9]) if known else inf,
        rest.resting,
        alarm.reseed or alarm.swung,
        alarm.heading,
    )
    return ConditioningState(k, gyr, True, rest, gravity, bias, field, alarm.event), out
