"""A learning step of the events: whether the vehicle was turned unseen, and what follows."""

from math import atan2, pi
from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.events.axis_signs import carry_axes, watch_axes
from estimator.conditioning.events.gravity_signs import watch_gravity
from estimator.conditioning.events.heading_signs import likely, watch_heading
from estimator.conditioning.events.inflation import HeadingInflation, raise_doubt, release_inflation
from estimator.conditioning.events.jump_signs import looks_turned, watch_field
from estimator.conditioning.events.proof import (
    TurnProof,
    TurnSigns,
    proof_of,
    reset_signs,
    tells_turn,
)
from estimator.conditioning.field.calibration import restart_means
from estimator.conditioning.field.magnetic import has_heading, reference_norm, steepness
from estimator.conditioning.field.step import FieldStep, MagnetometerState
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.vertical.bias import inflate_heading
from estimator.conditioning.vertical.gravity import restart_gravity
from estimator.conditioning.vertical.step import VerticalState, VerticalStep
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD, weighing, with_variance
from estimator.geometry.quaternion import dot
from estimator.geometry.spread import ANY_DIRECTION_VARIANCE, HALF_TURN_VARIANCE
from estimator.types import Vec2


class EventsState(NamedTuple):
    """What speaks for an unsensed turn, and what is in doubt after one."""

    signs: TurnSigns = TurnSigns()
    inflation: HeadingInflation = HeadingInflation()


class EventsStep(NamedTuple):
    """The three wings' states after a learning step."""

    vertical: VerticalState
    field: MagnetometerState
    events: EventsState


with_turn = replacer(VerticalState, "estimate", "gravity", "tilt")
with_estimate = replacer(VerticalState, "estimate")
with_inflation = replacer(VerticalState, "estimate", "inflation")
with_calibration = replacer(MagnetometerState, "calibration")


@inlined
def follow_signs(
    params: ConditioningParams,
    before: TurnSigns,
    mean: Gathered,
    vertical: VerticalStep,
    field: FieldStep,
) -> TurnSigns:
    """Each sign followed by one step's mean readings."""
    now, magnetic, since_s = vertical.state, field.state.magnetic, field.since_s
    heading, jump = before.heading, before.jump
    axes = carry_axes(before.axes, vertical, mean.time_s)
    if field.seen:
        turning = dot(vertical.rate, vertical.rate)
        jump = watch_field(jump, mean.field_g, turning, vertical.aliasing, since_s)
        learnt, usual_norm = field.state.calibration.learnt, reference_norm(magnetic)
        force_scatter = before.gravity.force_scatter
        axes = watch_axes(axes, vertical, jump, learnt, usual_norm, force_scatter, since_s)
    if field.seen and has_heading(magnetic):
        heading = watch_heading(params, heading, now.estimate, magnetic, field.horizontal, since_s)
    dt = mean.time_s
    weighed = weighing(params, dt)
    gravity = watch_gravity(params, before.gravity, now.gravity, dt, now.inflation, weighed)
    return TurnSigns(heading, gravity, jump, axes)


@inlined
def react(proof: TurnProof, before: VerticalState, horizontal: Vec2) -> VerticalState:
    """After an unsensed turn: gravity anew, and as much doubt in the heading as it needs.

    ``horizontal`` is the field's north and east part.
    """
    gravity, tilt, estimate = before.gravity, before.tilt, before.estimate
    if proof.gravity:
        gravity = restart_gravity(gravity)
        tilt = with_variance(tilt, ANY_DIRECTION_VARIANCE)
        estimate = inflate_heading(estimate, HALF_TURN_VARIANCE)
    elif proof.heading:
        estimate = inflate_heading(estimate, atan2(horizontal[1], horizontal[0]) ** 2)
    return with_turn(before, estimate, gravity, tilt)


@inlined
def learn_events(
    params: ConditioningParams,
    before: EventsState,
    mean: Gathered,
    vertical: VerticalStep,
    field: FieldStep,
) -> EventsStep:
    """Look for a turn that the gyroscope has not shown, and undo what it has spoilt."""
    magnetic, calibration = field.state.magnetic, field.state.calibration
    signs = follow_signs(params, before.signs, mean, vertical, field)
    inflation, was_doubted, released = before.inflation, before.inflation.variance > 0.0, False
    proof, seen_rad = proof_of(params, signs, calibration.learnt, reference_norm(magnetic))
    now = react(proof, with_estimate(vertical.state, field.estimate), field.horizontal)
    heading_rad, estimate, tilt = now.estimate.heading_rad, now.estimate, now.inflation
    if proof.jump > 0.0:
        inflation = raise_doubt(inflation, signs, proof.jump, steepness(magnetic.reference))
        # beside a magnet a turn is the less likely
        tilt += proof.jump * likely(signs.heading.mean_confidence)
        tilt = min(tilt, HALF_TURN_VARIANCE)
    if field.seen and (inflation.variance > 0.0 or tilt > 0.0):
        inflation, tilt, estimate, released = release_inflation(
            params, inflation, tilt, estimate, magnetic, signs.jump, field.horizontal, mean.time_s
        )
    if was_doubted and inflation.variance == 0.0 and not released:
        seen_rad = pi  # the rest of that jump is a magnet's, too
    turned = tells_turn(proof) or proof.jump > 0.0
    turned = turned or (field.seen and looks_turned(params, signs.jump))
    if turned or vertical.clipped > LEAST_OFF_RAD**2:
        calibration = restart_means(calibration)
    signs = reset_signs(signs, proof, seen_rad, heading_rad, proof.heading or released)
    return EventsStep(
        vertical=with_inflation(now, estimate, tilt),
        field=with_calibration(field.state, calibration),
        events=EventsState(signs, inflation),
    )
