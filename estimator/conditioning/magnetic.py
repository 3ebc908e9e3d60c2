"""How far the field can be trusted: its norm and dip against learnt references."""

from math import sqrt

from estimator.compilation.compiled import inlined
from estimator.conditioning.types import ConditioningParams, MagneticState
from estimator.types import Vec3

# A field with less than this share of the downward part in the horizontal has no heading.
LEAST_HORIZONTAL = 0.02


@inlined
def observe_field(
    params: ConditioningParams, state: MagneticState, field_6d: Vec3, dt_s: float
) -> MagneticState:
    """Confidence of the field in the level frame, and what it teaches the references.

    Norm n and dip d say without any heading whether the field is the one the
    references were learnt in: D^2 = ((n - n_r)/(s_n n_r))^2 + ((d - d_r)/s_d)^2,
    c = 1/(1 + D^2)^2, the weight of a robust estimator whose loss saturates
    (Geman and McClure 1987). sin(d - d_r) stands for the angle: both come from
    the horizontal and the downward part. The references follow with the weight
    c dt/tau, during the first tau as a running mean, so that a magnet passing
    later teaches them nothing.
    """
    age = state.age_s + dt_s
    samples = state.samples + 1.0
    h = sqrt(field_6d[0] * field_6d[0] + field_6d[1] * field_6d[1])
    v = field_6d[2]
    if not state.known:
        return MagneticState(h, v, h, v, samples, age, 0.0, 1.0, True)
    a = dt_s / (params.field_tau_s + dt_s)
    h = state.horizontal + a * (h - state.horizontal)
    v = state.down + a * (v - state.down)
    h_r = state.horizontal_reference
    v_r = state.down_reference
    n = sqrt(h * h + v * v)
    n_r = sqrt(h_r * h_r + v_r * v_r)
    off_norm = (n - n_r) / (params.field_norm_scale * n_r)
    off_dip = (v * h_r - h * v_r) / (params.field_dip_scale_rad * n * n_r)
    confidence = 1.0 / (1.0 + off_norm * off_norm + off_dip * off_dip) ** 2
    learn = min(1.0, dt_s / params.field_reference_tau_s) * confidence
    if age < params.field_reference_tau_s:
        learn = max(learn, 1.0 / samples)
    h_r += learn * (h - h_r)
    v_r += learn * (v - v_r)
    if not params.use_confidence:
        confidence = 1.0
    return MagneticState(h, v, h_r, v_r, samples, age, 0.0, confidence, True)


@inlined
def wait_for_field(state: MagneticState, dt_s: float) -> MagneticState:
    """A step with no field sample: only time passes."""
    return MagneticState(
        state.horizontal,
        state.down,
        state.horizontal_reference,
        state.down_reference,
        state.samples,
        state.age_s,
        state.wait_s + dt_s,
        state.confidence,
        state.known,
    )


@inlined
def reference_norm(state: MagneticState) -> float:
    """Norm of the learnt field."""
    return sqrt(state.horizontal_reference**2 + state.down_reference**2)


@inlined
def has_heading(state: MagneticState) -> bool:
    """Whether the learnt field has a horizontal part that can tell a heading."""
    return state.known and state.horizontal_reference > LEAST_HORIZONTAL * abs(state.down_reference)
