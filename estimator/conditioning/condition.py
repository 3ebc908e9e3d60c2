"""The conditioning stage: from one IMU sample to the paper's vectors."""

from math import cos, sin
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import compiled, inlined, replacer
from estimator.conditioning.events.step import learn_events
from estimator.conditioning.field.calibration import correct_field
from estimator.conditioning.field.step import learn_field
from estimator.conditioning.gather import NOTHING, STEP_S, gather, means
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.sigma import certainty_of
from estimator.conditioning.state import ConditioningState, Directions
from estimator.conditioning.vertical.gravity import level_to, with_frame
from estimator.conditioning.vertical.rate import (
    at_interval_end,
    corrected_rate,
    integration_rate,
    is_mean,
    watch_clipping,
)
from estimator.conditioning.vertical.step import (
    VerticalState,
    begin_vertical,
    learn_vertical,
    with_turn,
)
from estimator.conditioning.vertical.tilt import slowness
from estimator.geometry.axes import axes_of, down_of, to_body
from estimator.geometry.quaternion import (
    conjugate,
    exp,
    log,
    multiply,
    normalize,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.types import IDENTITY, ZERO_VEC3, Between, Quaternion, Sample, Vec3

with_step = replacer(
    ConditioningState, "vertical", "field", "events", "gathered", "directions", "certainty"
)


@inlined
def learn(
    params: ConditioningParams, state: ConditioningState, between: Between
) -> ConditioningState:
    """One learning step on what was gathered; ``between`` is known of the last sample's turning."""
    mean = means(state.gathered)
    force_scatter = state.events.gravity.force_scatter
    levelled = learn_vertical(params, state.vertical, mean, between, force_scatter)
    seen = learn_field(params, state.field, mean, levelled)
    now = learn_events(params, state.events, mean, levelled, seen)
    certainty = certainty_of(params, now.vertical, now.field, now.events)
    q = level_to(now.vertical.gravity.q_6d_g, now.vertical.gravity.force.best.value)[0]
    heading_rad = now.vertical.estimate.heading_rad
    north_6d = (cos(heading_rad), -sin(heading_rad), 0.0)
    directions = Directions(down_of(q), rotate_inverse(q, north_6d))
    return with_step(state, now.vertical, now.field, now.events, NOTHING, directions, certainty)


class Conditioned(NamedTuple):
    """The paper's vectors, and what else the filter and the publisher need.

    The last fields are those of a :class:`~estimator.conditioning.sigma.Certainty`.
    """

    rate_rad_s: Vec3 = ZERO_VEC3  # free of bias, the one that integrates best over the step; FRD
    turn: Quaternion = IDENTITY  # by that rate: the body's attitude after the step in that before
    bias_rad_s: Vec3 = ZERO_VEC3  # of the gyroscope, FRD
    gravity_b: Vec3 = (0.0, 0.0, 1.0)  # down, a unit vector in FRD
    magnetic_b: Vec3 = (1.0, 0.0, 0.0)  # magnetic north, horizontal, a unit vector in FRD
    has_heading: bool = False  # whether a field has shown it
    gravity_confidence: float = 0.0  # 0..1, falls with accelerations
    magnetic_confidence: float = 0.0  # 0..1, of the present field; 0 without one
    sigma_inclination_rad: float = 0.0  # angle that 68 % of the errors lie under
    sigma_brief_rad: float = 0.0  # the same if no acceleration lasted
    sigma_heading_rad: float = 0.0  # likewise; infinite without a heading


with_vectors = replacer(Sample, "acc_m_s2", "mag", "dt_s")
with_sample = replacer(ConditioningState, "vertical", "started", "previous_gyr_rad_s", "gathered")


@compiled
def condition(
    params: ConditioningParams, state: ConditioningState, sample: Sample
) -> tuple[ConditioningState, Conditioned]:
    """Take one sample, of which the field may be in any unit."""
    gyr, acc, mag, is_first = sample.gyr_rad_s, sample.acc_m_s2, sample.mag, not state.started
    # Before the first sample there was no interval; what it shows counts as one step's.
    dt = STEP_S if is_first else max(sample.dt_s, TINY)
    before = gyr if is_first else state.previous_gyr_rad_s
    rate = integration_rate(before, gyr, dt, params.averaged_samples)
    if sample.between.given:
        rate = sample.between.turn_rad_s
    rate = subtract(rate, state.vertical.estimate.bias_rad_s)
    turn = exp(scale(dt, rate))
    if is_mean(dt, params.averaged_samples) and not is_first:
        acc = at_interval_end(acc, gyr, dt)
        if params.averaged_samples:
            mag = at_interval_end(mag, gyr, dt)
    if sample.has_mag:
        mag = correct_field(mag, rate, state.field.calibration.learnt)
    vertical = state.vertical
    q_g_frd = normalize(multiply(vertical.gravity.q_g_frd, turn))
    clipping = watch_clipping(vertical.clipping, state.previous_gyr_rad_s, gyr, dt)
    vertical = with_turn(vertical, with_frame(vertical.gravity, q_g_frd), clipping)
    if is_first:
        vertical = begin_vertical(vertical, gyr, acc)
    axes_g = axes_of(vertical.gravity.q_g_frd)
    gathered = gather(state.gathered, axes_g, with_vectors(sample, acc, mag, dt))
    state = with_sample(state, vertical, True, gyr, gathered)
    if is_first or gathered.time_s >= STEP_S:
        state = learn(params, state, sample.between)
        slow = 0.0 if is_first else slowness(params, dt)
        if slow > 0.0:
            # by how much gyroscope and vectors together have turned the vehicle
            missed = log(multiply(conjugate(ned_of_g(vertical)), ned_of_g(state.vertical)))
            missed = rotate_inverse(state.vertical.gravity.q_g_frd, missed)
            rate = corrected_rate(rate, missed, slow, dt)
            turn = exp(scale(dt, rate))
    bias_rad_s = state.vertical.estimate.bias_rad_s
    gravity_b = to_body(axes_g, state.directions.down_g)
    magnetic_b = to_body(axes_g, state.directions.north_g)
    return state, Conditioned(rate, turn, bias_rad_s, gravity_b, magnetic_b, *state.certainty[:])


@inlined
def ned_of_g(vertical: VerticalState) -> Quaternion:
    """The rotation from G to north, east and down, as far as they are known."""
    half = 0.5 * vertical.estimate.heading_rad
    return multiply((cos(half), 0.0, 0.0, sin(half)), vertical.gravity.q_6d_g)
