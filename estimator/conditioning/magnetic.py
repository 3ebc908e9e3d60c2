"""How far the field can be trusted: its norm and dip against a reference."""

from math import sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import (
    ConditioningParams,
    FieldLook,
    FieldReference,
    FieldRival,
    MagneticState,
    Two,
)
from estimator.types import Vec3

# A field with less than this share of the downward part in the horizontal has no heading.
LEAST_HORIZONTAL = 0.02
# Averaging (s) of how uneven the field is, and the most that one look counts for.
UNEVEN_TAU_S = 20.0
MOST_UNEVEN = 0.15
# A field that neither the expected nor the other one resembles by this much is a third one.
LEAST_ALIKE = 0.3
# A field weaker than this share of the expected one is no field, and has no dip.
LEAST_SHARE = 1e-6


@inlined
def horizontal_down(field: Vec3) -> Two:
    """Horizontal part and downward part of a field in a level frame."""
    return (sqrt(field[0] * field[0] + field[1] * field[1]), field[2])


@inlined
def look_at_field(
    before: FieldLook, seen: Two, share: float, expected: Two, norm_scale: float, dip_scale: float
) -> FieldLook:
    """The look moved by ``share`` of its way to a sample, and its confidence.

    ``seen`` and ``expected`` are (horizontal, down). Norm n and dip d say without any heading
    whether the field is the expected one: D^2 = ((n - n_r)/(s_n n_r))^2 + (sin(d - d_r)/s_d)^2,
    c = 1/(1 + D^2)^2, the weight of a robust estimator whose loss saturates (Geman and McClure
    1987). The sine stands for the angle: both dips come from a horizontal and a downward part.
    """
    h = before.horizontal + share * (seen[0] - before.horizontal)
    v = before.down + share * (seen[1] - before.down)
    h_r, v_r = expected
    n_r = sqrt(h_r * h_r + v_r * v_r)
    if n_r == 0.0:  # readings of nothing have taught the reference: nothing resembles it
        return FieldLook(horizontal=h, down=v, confidence=0.0)
    n = max(sqrt(h * h + v * v), LEAST_SHARE * n_r)
    inverse = 1.0 / (n * n_r)
    off_norm = (n - n_r) * n * inverse * (1.0 / norm_scale)
    off_dip = (v * h_r - h * v_r) * inverse * (1.0 / dip_scale)
    confidence = 1.0 / (1.0 + off_norm * off_norm + off_dip * off_dip) ** 2
    return FieldLook(horizontal=h, down=v, confidence=confidence)


@inlined
def observe_field(
    params: ConditioningParams, state: MagneticState, field_6d: Vec3, dt_s: float, settled: float
) -> MagneticState:
    """Confidence of the field in the level frame, and what it teaches the reference.

    The reference follows with the weight c dt/tau, during the first tau as a
    running mean, so that a magnet passing later teaches it nothing. What was seen
    while the vertical was new counts little in that mean: ``settled`` is 1 once it is known.
    Soon after, the mean counts its readings as if there had been no such time: a magnet that
    passes in the first tau shall not teach it more.
    """
    before = state.reference
    age = before.age_s + dt_s
    weight = settled * settled
    catches_up = age > 2.0 * params.gravity_tau_s and before.samples * dt_s < age
    samples = before.samples + (2.0 * weight if catches_up else weight)
    h, v = horizontal_down(field_6d)
    if not state.known:
        look = FieldLook(horizontal=h, down=v, confidence=1.0)
        nothing = FieldRival(horizontal=h, down=v, seen_s=0.0)
        reference = FieldReference(h, v, samples, age, dt_s, nothing, is_new=False, uneven=0.0)
        return MagneticState(look, reference, 0.0, True)
    a = dt_s / (params.field_tau_s + dt_s)
    expected = (before.horizontal, before.down)
    norm_scale, dip_scale = params.field_norm_scale, params.field_dip_scale_rad
    look = look_at_field(state.look, (h, v), a, expected, norm_scale, dip_scale)
    learn = min(1.0, dt_s / params.field_reference_tau_s) * look.confidence
    if age < params.field_reference_tau_s:
        learn = max(learn, weight / samples)
    other, borne_s = watch_rival(params, before, look, dt_s)
    reference = FieldReference(
        horizontal=before.horizontal + learn * (look.horizontal - before.horizontal),
        down=before.down + learn * (look.down - before.down),
        samples=samples,
        age_s=age,
        borne_s=borne_s,
        other=other,
        is_new=False,
        uneven=unevenness(before, look, dt_s),
    )
    if other.seen_s > borne_s:
        reference = believe_rival(reference)
    if not params.use_confidence:
        look = FieldLook(horizontal=look.horizontal, down=look.down, confidence=1.0)
    return MagneticState(look, reference, 0.0, True)


@inlined
def unevenness(reference: FieldReference, look: FieldLook, dt_s: float) -> float:
    """Mean square of how far norm and dip are off the expected ones, a magnet's clipped."""
    h, v, h_r, v_r = look.horizontal, look.down, reference.horizontal, reference.down
    n_r = sqrt(h_r * h_r + v_r * v_r)
    if n_r == 0.0:
        return reference.uneven
    n = max(sqrt(h * h + v * v), LEAST_SHARE * n_r)
    inverse = 1.0 / (n * n_r)
    off_norm = min(abs(n - n_r) * n * inverse, MOST_UNEVEN)
    off_dip = min(abs(v * h_r - h * v_r) * inverse, MOST_UNEVEN)
    share = dt_s / (min(UNEVEN_TAU_S, reference.age_s) + dt_s)
    return reference.uneven + share * (off_norm**2 + off_dip**2 - reference.uneven)


@inlined
def watch_rival(
    params: ConditioningParams, reference: FieldReference, look: FieldLook, dt_s: float
) -> tuple[FieldRival, float]:
    """The other field that is seen, and for how long the expected one has been borne out.

    What one gains the other loses, so that a field has to last for as long as the one before it
    has, half of ``field_borne_s`` at most. A field that changes is none.
    """
    other, most = reference.other, params.field_borne_s
    norm_scale, dip_scale = params.field_norm_scale, params.field_dip_scale_rad
    seen = (look.horizontal, look.down)
    expected = (other.horizontal, other.down)
    alike = look_at_field(look, seen, 0.0, expected, norm_scale, dip_scale).confidence
    gain = dt_s * (alike - look.confidence)
    borne_s = max(0.0, min(reference.borne_s + dt_s * look.confidence - max(gain, 0.0), most))
    seen_s = min(other.seen_s + gain, most)
    if seen_s <= 0.0 or alike + look.confidence < LEAST_ALIKE:
        if alike + look.confidence < LEAST_ALIKE and seen_s > dt_s:
            return FieldRival(other.horizontal, other.down, seen_s - dt_s), borne_s
        return FieldRival(look.horizontal, look.down, 0.0), borne_s
    share = alike * min(1.0, dt_s / (seen_s + dt_s))
    return FieldRival(
        horizontal=other.horizontal + share * (look.horizontal - other.horizontal),
        down=other.down + share * (look.down - other.down),
        seen_s=seen_s,
    ), borne_s


@inlined
def believe_rival(reference: FieldReference) -> FieldReference:
    """The two change places."""
    other = reference.other
    return FieldReference(
        horizontal=other.horizontal,
        down=other.down,
        samples=reference.samples,
        age_s=reference.age_s,
        borne_s=other.seen_s,
        other=FieldRival(reference.horizontal, reference.down, reference.borne_s),
        is_new=True,
        uneven=reference.uneven,
    )


@inlined
def wait_for_field(state: MagneticState, dt_s: float) -> MagneticState:
    """A step with no field sample: only time passes."""
    return MagneticState(state.look, state.reference, state.wait_s + dt_s, state.known)


@inlined
def reference_norm(state: MagneticState) -> float:
    """Norm of the learnt field."""
    return sqrt(state.reference.horizontal**2 + state.reference.down**2)


@inlined
def has_heading(state: MagneticState) -> bool:
    """Whether the learnt field has a horizontal part that can tell a heading."""
    reference = state.reference
    return state.known and reference.horizontal > LEAST_HORIZONTAL * abs(reference.down)
