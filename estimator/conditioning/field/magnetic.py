"""The confidence in the field, by its norm and dip against a reference, and robust weights.

The field may be in any unit: only its direction and its relative changes are used.
"""

from math import sqrt
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import (
    FIELD_S,
    HEADING_REACH_RAD,
    REACH,
    USUAL_S,
    ConditioningParams,
)
from estimator.types import Vec2, Vec3

# Relative deviation of the norm that counts as one, more than calibrations leave. A field whose
# horizontal part is less than this share of the downward one shows no heading.
NORM_SCALE = 0.1
# What changes the norm by so much turns the dip by as much.
DIP_SCALE_RAD = NORM_SCALE
# By this share of it (and angle, rad) a field is off if nothing else is known about it.
MOST_DISTORTION = 0.2
# A field that neither the expected nor the other one resembles by this much is a third one.
LEAST_ALIKE = 0.3


@inlined
def robust_factor(square: float) -> float:
    """Factor (1 + x^2)^2 of the noise's variance for a deviation x, from the square of x.

    The inverse is the weight of a robust estimator whose loss saturates (Geman and McClure 1987):
    deviations that are far off do not count.
    """
    return (1.0 + square) ** 2


@inlined
def residual_factor(residual: float, variance: float) -> float:
    """Factor of the noise of a heading's residual: 4 at :data:`HEADING_REACH_RAD`.

    A larger ``variance`` (rad^2) of the heading moves that point out: its error explains the
    residual.
    """
    return robust_factor(residual * residual / (HEADING_REACH_RAD**2 + REACH**2 * variance))


class FieldLook(NamedTuple):
    """The field as it was seen lately, and how far it resembles its reference."""

    horizontal: float = 0.0  # low-passed, in the field's own unit
    down: float = 0.0  # low-passed, in the field's own unit
    confidence: float = 0.0  # 0..1, from norm and dip


class AlternativeField(NamedTuple):
    """A field that is seen in place of the one expected."""

    horizontal: float = 0.0  # in the field's own unit
    down: float = 0.0  # in the field's own unit
    seen_s: float = 0.0  # for how long it has been seen, less the time it has not


class FieldReference(NamedTuple):
    """The field that the place and the vehicle are taken to have."""

    horizontal: float = 0.0  # in the field's own unit
    down: float = 0.0  # in the field's own unit
    samples: float = 0.0  # how many were learnt from
    age_s: float = 0.0  # the time that they stand for
    confirmed_s: float = 0.0  # for how long the field has looked so, less the time it has not
    other: AlternativeField = AlternativeField()  # another one that it may have
    is_new: bool = False  # whether this step has taken the other for it
    uneven: float = 0.0  # mean square of how far norm and dip are off, as shares and angles


class MagneticState(NamedTuple):
    """What is known about the field in the level frame 6D."""

    look: FieldLook = FieldLook()  # lately
    reference: FieldReference = FieldReference()  # usually
    wait_s: float = 0.0  # since the last sample of the field


@inlined
def horizontal_down(field: Vec3) -> Vec2:
    """Horizontal part and downward part of a field in a level frame."""
    return (sqrt(field[0] * field[0] + field[1] * field[1]), field[2])


@inlined
def norm_of(field: Vec2) -> float:
    """Norm of a field by its horizontal and downward part."""
    return sqrt(field[0] * field[0] + field[1] * field[1])


@inlined
def deviation(seen: Vec2, expected: Vec2) -> Vec2:
    """How far a field is off the expected one: the norm as a share, the dip as its sine.

    Both are (horizontal, down). The sine stands for the angle: both dips come from two parts.
    """
    n_r = norm_of(expected)
    n = max(norm_of(seen), TINY * n_r)  # no field has no dip
    inverse = 1.0 / (n * n_r)
    return (n - n_r) * n * inverse, (seen[1] * expected[0] - seen[0] * expected[1]) * inverse


@inlined
def look_at_field(
    before: FieldLook, seen: Vec2, share: float, expected: Vec2, norm_scale: float, dip_scale: float
) -> FieldLook:
    """The look moved by ``share`` of its way to a sample, and its confidence.

    ``seen`` and ``expected`` are (horizontal, down). Norm n and dip d show without a heading
    whether the field is the expected one: D^2 = ((n - n_r)/(s_n n_r))^2 + (sin(d - d_r)/s_d)^2. The
    confidence is the robust estimator's weight of that.
    """
    h = before.horizontal + share * (seen[0] - before.horizontal)
    v = before.down + share * (seen[1] - before.down)
    if norm_of(expected) == 0.0:  # learnt from zero readings: nothing resembles it
        return FieldLook(h, v, 0.0)
    off_norm, off_dip = deviation((h, v), expected)
    square = (off_norm * (1.0 / norm_scale)) ** 2 + (off_dip * (1.0 / dip_scale)) ** 2
    return FieldLook(h, v, 1.0 / robust_factor(square))


@inlined
def observe_field(
    params: ConditioningParams, state: MagneticState, field_6d: Vec3, dt_s: float, settled: float
) -> MagneticState:
    """Confidence of the field in the level frame, and what the reference learns from it.

    The reference follows with the weight c dt/tau, during the first tau as a running mean, so that
    a magnet that passes later teaches it nothing. Samples count little in that mean while the
    vertical is new: ``settled`` is 1 once it is known. Soon after, the mean catches up.
    """
    before = state.reference
    age = before.age_s + dt_s
    weight = settled * settled
    catches_up = age > 2.0 * params.gravity_tau_s and before.samples * dt_s < age
    samples = before.samples + (2.0 * weight if catches_up else weight)
    h, v = horizontal_down(field_6d)
    if before.samples <= 0.0:
        other = AlternativeField(h, v, 0.0)
        reference = FieldReference(h, v, samples, age, dt_s, other, is_new=False, uneven=0.0)
        return MagneticState(FieldLook(h, v, 1.0), reference, 0.0)
    a = dt_s / (FIELD_S + dt_s)
    expected = (before.horizontal, before.down)
    look = look_at_field(state.look, (h, v), a, expected, NORM_SCALE, DIP_SCALE_RAD)
    learn = min(1.0, dt_s / USUAL_S) * look.confidence
    if age < USUAL_S:
        learn = max(learn, weight / samples)
    reference = before._replace(
        horizontal=before.horizontal + learn * (look.horizontal - before.horizontal),
        down=before.down + learn * (look.down - before.down),
        samples=samples,
        age_s=age,
        is_new=False,
        uneven=unevenness(before, look, dt_s),
    )
    reference = watch_alternative(reference, look, dt_s)
    if not params.use_confidence:
        look = look._replace(confidence=1.0)
    return MagneticState(look, reference, 0.0)


@inlined
def unevenness(reference: FieldReference, look: FieldLook, dt_s: float) -> float:
    """Mean square of how far norm and dip are off the expected ones; one look counts little."""
    expected = (reference.horizontal, reference.down)
    if norm_of(expected) == 0.0:
        return reference.uneven
    off_norm, off_dip = deviation((look.horizontal, look.down), expected)
    off_norm, off_dip = min(abs(off_norm), NORM_SCALE), min(abs(off_dip), NORM_SCALE)
    share = dt_s / (min(USUAL_S, reference.age_s) + dt_s)
    return reference.uneven + share * (off_norm**2 + off_dip**2 - reference.uneven)


@inlined
def watch_alternative(reference: FieldReference, look: FieldLook, dt_s: float) -> FieldReference:
    """The reference beside another field that is seen; they change places once that lasts longer.

    One field loses what the other gains, so the other has to last as long as the expected one has,
    at most :data:`USUAL_S`. A field that keeps changing starts anew each time.
    """
    other, most = reference.other, 2.0 * USUAL_S
    seen, expected = (look.horizontal, look.down), (other.horizontal, other.down)
    alike = look_at_field(look, seen, 0.0, expected, NORM_SCALE, DIP_SCALE_RAD).confidence
    gain = dt_s * (alike - look.confidence)
    confirmed_s = reference.confirmed_s + dt_s * look.confidence - max(gain, 0.0)
    confirmed_s = max(0.0, min(confirmed_s, most))
    seen_s = min(other.seen_s + gain, most)
    is_third = alike + look.confidence < LEAST_ALIKE
    if is_third and seen_s > dt_s:
        other = other._replace(seen_s=seen_s - dt_s)
    elif is_third or seen_s <= 0.0:
        other = AlternativeField(look.horizontal, look.down, 0.0)
    else:
        share = alike * min(1.0, dt_s / (seen_s + dt_s))
        other = AlternativeField(
            horizontal=other.horizontal + share * (look.horizontal - other.horizontal),
            down=other.down + share * (look.down - other.down),
            seen_s=seen_s,
        )
    if other.seen_s <= confirmed_s:
        return reference._replace(confirmed_s=confirmed_s, other=other)
    given_up = AlternativeField(reference.horizontal, reference.down, confirmed_s)
    return reference._replace(
        horizontal=other.horizontal,
        down=other.down,
        confirmed_s=other.seen_s,
        other=given_up,
        is_new=True,
    )


@inlined
def reference_norm(state: MagneticState) -> float:
    """Norm of the learnt field."""
    return norm_of((state.reference.horizontal, state.reference.down))


@inlined
def has_heading(state: MagneticState) -> bool:
    """Whether the learnt field has a horizontal part that shows a heading."""
    return state.reference.horizontal > NORM_SCALE * abs(state.reference.down)


@inlined
def steepness(reference: FieldReference) -> float:
    """Squared tangent of the learnt field's dip, 0 without a field.

    A tilt bends the heading by its root. The steepest field that still shows a heading bounds it.
    """
    h = max(reference.horizontal, NORM_SCALE * abs(reference.down))
    return (reference.down / h) ** 2 if h > 0.0 else 0.0
