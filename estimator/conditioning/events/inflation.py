"""What a jump of the field leaves in doubt: the vertical until the force tells, then the heading.

The doubt in the vertical is one variance, which the vertical wing keeps and takes down.
"""

from math import asin, atan2, sin, sqrt
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.events.jump_signs import JumpSigns, jump_share
from estimator.conditioning.events.proof import TurnSigns
from estimator.conditioning.field.magnetic import MagneticState, steepness
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.times import LONGEST_STEP_S, SPAN_S
from estimator.conditioning.vertical.bias import Estimate, clip, inflate_heading
from estimator.conditioning.vertical.lasting import SCALE_ERROR
from estimator.geometry.spread import HALF_TURN_VARIANCE
from estimator.types import Vec2

# The share of a turn that its jump shows: of one within 0.4 s. Noise adds to either.
SUDDEN_SHARE = 0.9


class FieldBefore(NamedTuple):
    """The field before a turn that no sensor has felt."""

    norm: float = 0.0  # in its own unit
    confidence: float = 0.0  # averaged


class HeadingInflation(NamedTuple):
    """How far the heading is in doubt; it hears of that once the field looks as usual again."""

    variance: float = 0.0  # rad^2
    usual_s: float = 0.0  # for how long it has looked so, less the time it has not
    before: FieldBefore = FieldBefore()  # the turn


@inlined
def raise_doubt(
    inflation: HeadingInflation, signs: TurnSigns, variance: float, steepness: float
) -> HeadingInflation:
    """The doubt after the field has jumped, by a turn whose angle has the ``variance`` (rad^2).

    A steep field makes more of it: ``steepness`` is the squared tangent of the dip.
    """
    before = FieldBefore(signs.jump.slow_norm, signs.heading.mean_confidence)
    return HeadingInflation(
        variance=min(inflation.variance + variance * (1.0 + steepness), HALF_TURN_VARIANCE),
        usual_s=0.0,
        before=before if inflation.variance == 0.0 else inflation.before,
    )


@inlined
def is_sudden(noise: float, variance: float, steepness: float, horizontal: Vec2) -> bool:
    """Whether most of the angle by which the field is off by now came in the jump at once.

    A magnet that passes takes its time. ``noise`` (rad^2) is the variance of what a jump tells. A
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
    """Hand the heading its doubt once the field has looked as usual for a while.

    A magnet that has turned the field shows in norm or dip, now or soon, and must not draw the
    heading: the field has to stand still again, and nothing is left of either doubt if its norm
    is another. And a heading by the field is never better than the vertical it was taken with,
    whose doubt is ``tilt`` (rad^2).

    Returns both doubts, the estimate and whether the heading was given up.
    """
    # D^2 by which it looks less usual than before the turn, and by which it still moves
    off = sqrt(max(inflation.before.confidence, TINY) / max(field.look.confidence, TINY)) - 1.0
    off = max(0.0, off) + (jump.moves_rad / params.turn_jump_rad) ** 2
    usual_s = max(0.0, inflation.usual_s + clip(2.0 * (1.0 - off), 1.0) * min(dt_s, LONGEST_STEP_S))
    most = SCALE_ERROR + sqrt(field.reference.uneven)
    left, before = inflation.variance, inflation.before
    if left > 0.0 and abs(jump.quick_norm - before.norm) > most * before.norm:
        return HeadingInflation(0.0, usual_s, before), 0.0, estimate, False
    if usual_s <= SPAN_S:
        return HeadingInflation(left, usual_s, before), tilt, estimate, False
    steep = steepness(field.reference)
    if not is_sudden(jump.usual / jump_share() ** 2, left, steep, horizontal):
        left = 0.0
    now = estimate.covariance[9]
    raised = max(now + left, 0.5 * tilt * steep) - now
    return (
        HeadingInflation(0.0, usual_s, before),
        tilt,
        inflate_heading(estimate, raised),
        left > 0.0,
    )
