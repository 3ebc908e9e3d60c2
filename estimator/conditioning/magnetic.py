"""How far the field can be trusted: its norm and dip against a reference."""

from math import sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import (
    ConditioningParams,
    FieldLook,
    FieldReference,
    MagneticState,
    Two,
)
from estimator.types import Vec3

# A field with less than this share of the downward part in the horizontal has no heading.
LEAST_HORIZONTAL = 0.02


@inlined
def horizontal_down(field: Vec3) -> Two:
    """Horizontal part and downward part of a field in a level frame."""
    return (sqrt(field[0] * field[0] + field[1] * field[1]), field[2])


@inlined
def confidence_of(off_norm: float, off_dip: float) -> float:
    """c = 1/(1 + D^2)^2, D^2 = off_norm^2 + off_dip^2, both in units of what counts as one.

    The weight of a robust estimator whose loss saturates (Geman and McClure 1987).
    """
    return 1.0 / (1.0 + off_norm * off_norm + off_dip * off_dip) ** 2


@inlined
def observe_field(
    params: ConditioningParams, state: MagneticState, field_6d: Vec3, dt_s: float
) -> MagneticState:
    """Confidence of the field in the level frame, and what it teaches the reference.

    Norm n and dip d say without any heading whether the field is the one the reference was
    learnt from: D^2 = ((n - n_r)/(s_n n_r))^2 + (sin(d - d_r)/s_d)^2. The sine stands for the
    angle: both dips come from a horizontal and a downward part.
    The reference follows with the weight c dt/tau, during the first tau as a
    running mean, so that a magnet passing later teaches it nothing.
    """
    before = state.reference
    age = before.age_s + dt_s
    samples = before.samples + 1.0
    h, v = horizontal_down(field_6d)
    if not state.known:
        look = FieldLook(horizontal=h, down=v, confidence=1.0)
        return MagneticState(look, FieldReference(h, v, samples, age), 0.0, True)
    a = dt_s / (params.field_tau_s + dt_s)
    h = state.look.horizontal + a * (h - state.look.horizontal)
    v = state.look.down + a * (v - state.look.down)
    h_r, v_r = before.horizontal, before.down
    n = sqrt(h * h + v * v)
    n_r = sqrt(h_r * h_r + v_r * v_r)
    off_norm = (n - n_r) / (params.field_norm_scale * n_r)
    off_dip = (v * h_r - h * v_r) / (params.field_dip_scale_rad * n * n_r)
    look = FieldLook(horizontal=h, down=v, confidence=confidence_of(off_norm, off_dip))
    learn = min(1.0, dt_s / params.field_reference_tau_s) * look.confidence
    if age < params.field_reference_tau_s:
        learn = max(learn, 1.0 / samples)
    reference = FieldReference(
        horizontal=before.horizontal + learn * (look.horizontal - before.horizontal),
        down=before.down + learn * (look.down - before.down),
        samples=samples,
        age_s=age,
    )
    if not params.use_confidence:
        look = FieldLook(horizontal=look.horizontal, down=look.down, confidence=1.0)
    return MagneticState(look, reference, 0.0, True)


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
