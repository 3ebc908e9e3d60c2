"""A learning step of the events: whether the vehicle was turned unseen, and what follows.

A jump of the field inflates the variance of the vertical until the force shows it, then that of
the heading. The vertical wing keeps the former.
"""

from math import asin, atan2, pi, sin, sqrt
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.events.axis_signs import AxisSigns, carry_axes, watch_axes
from estimator.conditioning.events.jump_signs import (
    JUMP_SHARE,
    JumpSigns,
    jump_variance,
    looks_turned,
    turn_of,
    watch_field,
)
from estimator.conditioning.events.turn_signs import (
    GravitySigns,
    HeadingSigns,
    begin_anew,
    give_up,
    likely,
    watch_gravity,
    watch_heading,
)
from estimator.conditioning.field.calibration import Calibration
from estimator.conditioning.field.magnetic import (
    DIP_SCALE_RAD,
    NORM_SCALE,
    MagneticState,
    has_heading,
    reference_norm,
    steepness,
)
from estimator.conditioning.field.step import FieldStep, MagnetometerState
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import LONGEST_STEP_S, REACH, SPAN_S, ConditioningParams
from estimator.conditioning.vertical.bias import Estimate, clip, inflate_heading
from estimator.conditioning.vertical.lowpass import Smooth
from estimator.conditioning.vertical.slow_acceleration import SCALE_ERROR
from estimator.conditioning.vertical.step import VerticalState, VerticalStep
from estimator.conditioning.vertical.tilt import LEAST_OFF_RAD, weighing
from estimator.geometry.quaternion import ANY_DIRECTION_VARIANCE, HALF_TURN_VARIANCE, dot, norm
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec2, Vec3

# The share of a turn that its jump shows: of one within 0.4 s. Noise adds to either.
SUDDEN_SHARE = 0.9


class HeadingInflation(NamedTuple):
    """Variance that a jump adds to the heading once the field looks as usual again."""

    variance: float = 0.0  # rad^2
    usual_s: float = 0.0  # for how long it has looked so, less the time it has not
    norm_before: float = 0.0  # of the field before the turn, in its own unit
    confidence_before: float = 0.0  # likewise, averaged
    no_jump: float = 0.0  # the vertical's inflation that no jump of the field has added, rad^2


class EventsState(NamedTuple):
    """How strong each sign of an unsensed turn is, and the variance inflated after one."""

    heading: HeadingSigns = HeadingSigns()  # of the field
    gravity: GravitySigns = GravitySigns()  # of the specific force
    jump: JumpSigns = JumpSigns()  # of the field in G
    axes: AxisSigns = AxisSigns()  # of the gyroscope's axes, by that field
    inflation: HeadingInflation = HeadingInflation()
    unsensed_turn: float = 0.0  # variance (rad^2) about any axis that this step has shown


# After a learning step.
States = tuple[VerticalState, MagnetometerState, EventsState]


@inlined
def inflate_variance(
    inflation: HeadingInflation, signs: EventsState, variance: float, steepness: float
) -> HeadingInflation:
    """The inflation after a jump of the field, by a turn of that ``variance`` (rad^2)."""
    raised = min(inflation.variance + variance * (1.0 + steepness), HALF_TURN_VARIANCE)
    if inflation.variance > 0.0:
        return inflation._replace(variance=raised, usual_s=0.0)
    norm, confidence = signs.jump.slow_norm, signs.heading.mean_confidence
    return HeadingInflation(raised, 0.0, norm, confidence, inflation.no_jump)


@inlined
def is_sudden(noise: float, variance: float, steepness: float, horizontal: Vec2) -> bool:
    """Whether most of the angle by which the field is off by now came in the jump at once.

    A magnet that passes takes its time. ``noise`` (rad^2) is the variance of what a jump shows. A
    heading off by h turns a field of dip d by 2 asin(cos d sin h/2).
    """
    off = abs(atan2(horizontal[1], horizontal[0]))
    turned = 2.0 * asin(sin(0.5 * off) / sqrt(1.0 + steepness))
    return SUDDEN_SHARE * turned - sqrt(noise) < sqrt(variance / (1.0 + steepness))


@inlined
def release_inflation(
    params: ConditioningParams,
    inflation: HeadingInflation,
    tilt: float,
    estimate: Estimate,
    field: MagneticState,
    jump: JumpSigns,
    horizontal: Vec2,
    dt_s: float,
) -> tuple[HeadingInflation, float, Estimate, bool]:
    """Add the inflation to the heading once the field has looked as usual for a while.

    A magnet that has turned the field must not draw the heading: the field has to stand still
    again, and what its jump has added to both inflations is dropped if its norm is another, or if
    it came to point elsewhere slowly. While the vertical's, ``tilt`` (rad^2), is large the dip
    shows nothing, so that the norm decides.

    Returns both inflations, the estimate and whether the heading was given up.
    """
    # D^2 by which it looks less usual than before the turn, beyond what an uncertain vertical makes
    # of its dip, and by which it still moves
    off = sqrt(max(inflation.confidence_before, TINY) / max(field.look.confidence, TINY)) - 1.0
    off -= 0.5 * tilt / DIP_SCALE_RAD**2
    off = max(0.0, off) + (jump.moves_rad / params.turn_jump_rad) ** 2
    usual_s = max(0.0, inflation.usual_s + clip(2.0 * (1.0 - off), 1.0) * min(dt_s, LONGEST_STEP_S))
    most = SCALE_ERROR + sqrt(field.reference.uneven)
    left, norm = inflation.variance, inflation.norm_before
    inflation = inflation._replace(usual_s=usual_s)
    if left > 0.0 and abs(jump.quick_norm - norm) > most * norm:
        return inflation._replace(variance=0.0), inflation.no_jump, estimate, False
    if usual_s <= SPAN_S:
        return inflation, tilt, estimate, False
    if not is_sudden(jump.usual / JUMP_SHARE**2, left, steepness(field.reference), horizontal):
        left, tilt = 0.0, inflation.no_jump if left > 0.0 else tilt
    released = inflate_heading(estimate, left)
    return inflation._replace(variance=0.0), tilt, released, left > 0.0


@inlined
def with_field_turned(estimate: Estimate, tilt: float, field: MagneticState) -> Estimate:
    """A heading no surer than its field, which a vertical of the variance ``tilt`` (rad^2) turns.

    Such an error lasts, so that means of the field do not lessen it.
    """
    if not has_heading(field):
        return estimate
    least = min(tilt * steepness(field.reference), HALF_TURN_VARIANCE)
    return inflate_heading(estimate, max(0.0, least - estimate.covariance[9]))


class TurnProof(NamedTuple):
    """Which signs of an unsensed turn have lasted for long enough."""

    heading: bool  # the field keeps pointing elsewhere
    gravity: bool  # gravity keeps pulling far elsewhere
    force: float  # variance (rad^2) of the turn that the force shows where no field can; 0: none
    jump: float  # variance (rad^2) of the turn by which the field has jumped; 0: it has not
    seen_rad: float  # the part of a jump that has counted


@inlined
def proof_of(
    params: ConditioningParams, signs: EventsState, learnt: Calibration, usual_norm: float
) -> TurnProof:
    """Which signs have lasted for long enough; ``usual_norm`` is that of the place's field."""
    if not params.use_events:
        return TurnProof(False, False, 0.0, 0.0, 0.0)
    heading = signs.heading
    jump, seen_rad = jump_variance(params, signs.jump, learnt)
    off = abs(signs.jump.quick_norm - usual_norm)
    if likely(heading.mean_confidence) <= 0.0 or off >= NORM_SCALE * usual_norm:
        jump = 0.0
    return TurnProof(
        heading=heading.confirmed_s <= 0.0 or heading.back_s > LONGEST_STEP_S,
        gravity=signs.gravity.off_s > LONGEST_STEP_S,
        force=signs.gravity.turned,
        jump=jump,
        seen_rad=seen_rad,
    )


@inlined
def shown_together(
    before: EventsState, now: EventsState, proof: TurnProof, mean: Gathered, quick: Vec3
) -> float:
    """Variance (rad^2) about any axis of an unsensed turn that field and force show together.

    In G both stand still unless the gyroscope has missed a turn, by which the field jumps and the
    force leaves ``quick``, its mean of a second, while the angle between the two stays. Less counts
    than such a mean is usually off, than an acceleration that changes the force's size may have
    turned it, and than the vehicle has turned by itself in that second. None counts within a second
    after field and force have contradicted an axis of the gyroscope, which makes such jumps, too.
    """
    if proof.jump <= 0.0 or before.axes.since_s < SPAN_S:
        return 0.0
    off = turn_of(mean.gravity_g, quick)
    between = turn_of(mean.gravity_g, mean.field_g) - turn_of(quick, before.jump.slow)
    size = norm(mean.gravity_g) / STANDARD_GRAVITY_M_S2 - 1.0
    usual = now.gravity.force_scatter + size * size + now.jump.turning * SPAN_S**2
    return max(0.0, off * off - usual - (REACH * between) ** 2)


@inlined
def follow_signs(
    params: ConditioningParams, before: EventsState, vertical: VerticalStep, field: FieldStep
) -> EventsState:
    """Each sign followed by one step's mean readings."""
    now, mean = vertical.state, vertical.mean
    magnetic, since_s = field.state.magnetic, field.since_s
    heading, jump = before.heading, before.jump
    axes = carry_axes(before.axes, vertical, mean.time_s)
    if mean.field_s > 0.0:
        turning = dot(vertical.rate, vertical.rate)
        jump = watch_field(params, jump, mean.field_g, turning, vertical.aliasing, since_s)
        scatter = before.gravity.force_scatter
        axes = watch_axes(axes, vertical, jump, reference_norm(magnetic), scatter, since_s)
    if mean.field_s > 0.0 and has_heading(magnetic):
        heading = watch_heading(params, heading, now.estimate, magnetic, field.horizontal, since_s)
    # a jump that is a magnet's shows no turn, so that the force has to
    is_known = magnetic.reference.samples > 0.0
    has_field = is_known and magnetic.wait_s < SPAN_S and jump.seen_rad < pi
    dt_s, weighed = mean.time_s, weighing(params, mean.time_s)
    gravity = watch_gravity(
        params, before.gravity, now.gravity, dt_s, now.inflation, weighed, has_field
    )
    return EventsState(heading, gravity, jump, axes, before.inflation, 0.0)


@inlined
def react(
    proof: TurnProof, before: VerticalState, horizontal: Vec2, has_jumped: bool
) -> VerticalState:
    """After an unsensed turn: gravity starts anew, and the heading's variance grows as needed.

    ``horizontal`` is the field's north and east part. If that field ``has_jumped``, the vertical
    has followed the force since, which an acceleration may have led astray: it follows on.
    """
    gravity, estimate = before.gravity, before.estimate
    tilt, inflation = before.tilt, before.inflation
    if proof.gravity and has_jumped:
        inflation = HALF_TURN_VARIANCE
    elif proof.gravity:
        anew = Smooth(ZERO_VEC3, ZERO_VEC3)  # the low-pass of the force
        force = gravity.force._replace(down=anew, best=anew, quick=ZERO_VEC3, age_s=0.0)
        gravity = gravity._replace(force=force)
    elif proof.force > 0.0:
        inflation = min(inflation + proof.force, HALF_TURN_VARIANCE)
    if proof.gravity:
        tilt = tilt._replace(variance=ANY_DIRECTION_VARIANCE)
        estimate = inflate_heading(estimate, HALF_TURN_VARIANCE)
    elif proof.heading:
        estimate = inflate_heading(estimate, atan2(horizontal[1], horizontal[0]) ** 2)
    return before._replace(estimate=estimate, gravity=gravity, tilt=tilt, inflation=inflation)


@inlined
def learn_events(
    params: ConditioningParams, before: EventsState, vertical: VerticalStep, field: FieldStep
) -> States:
    """Look for a turn that the gyroscope has not shown, and undo what it has spoilt."""
    magnetic, calibration = field.state.magnetic, field.state.calibration
    signs, mean = follow_signs(params, before, vertical, field), vertical.mean
    heading, gravity, jump, axes, inflation, _ = signs
    was_inflated, released = inflation.variance > 0.0, False
    proof = proof_of(params, signs, calibration.learnt, reference_norm(magnetic))
    unsensed_turn = shown_together(before, signs, proof, mean, vertical.state.gravity.force.quick)
    now = vertical.state._replace(estimate=field.estimate)
    now = react(proof, now, field.horizontal, was_inflated)
    heading_rad, estimate, tilt = now.estimate.heading_rad, now.estimate, now.inflation
    # what a jump has added shrinks with the whole, at the latest
    others = min(inflation.no_jump + vertical.clipped + proof.force, tilt)
    inflation = inflation._replace(no_jump=tilt if proof.gravity else others)
    if proof.jump > 0.0:
        inflation = inflate_variance(inflation, signs, proof.jump, steepness(magnetic.reference))
        # beside a magnet a turn is the less likely
        tilt = min(tilt + proof.jump * likely(heading.mean_confidence), HALF_TURN_VARIANCE)
    if mean.field_s > 0.0 and (inflation.variance > 0.0 or tilt > 0.0):
        inflation, tilt, estimate, released = release_inflation(
            params, inflation, tilt, estimate, magnetic, jump, field.horizontal, mean.time_s
        )
    if inflation.variance == 0.0:
        estimate = with_field_turned(estimate, tilt, magnetic)
    is_magnets = was_inflated and inflation.variance == 0.0 and not released
    turned = proof.heading or proof.gravity or proof.jump > 0.0
    turned = turned or (mean.field_s > 0.0 and looks_turned(params, jump))
    if turned or vertical.clipped > LEAST_OFF_RAD**2:
        calibration = calibration._replace(age_s=0.0)  # its means are of the old attitude
    # the signs that were proof enough start anew
    if proof.heading or released:
        heading = give_up(heading, heading_rad)
    elif proof.gravity:
        heading = begin_anew(heading)
    if proof.gravity:
        gravity = gravity._replace(off_s=0.0)
    # where a magnet has jumped, the rest of that jump is its, too
    jump = jump._replace(seen_rad=pi if is_magnets else proof.seen_rad)
    return (
        now._replace(estimate=estimate, inflation=tilt),
        MagnetometerState(calibration, magnetic),
        EventsState(heading, gravity, jump, axes, inflation, unsensed_turn),
    )
