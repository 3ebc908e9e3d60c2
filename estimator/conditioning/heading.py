"""The heading correction from the horizontal field."""

from math import atan2, cos, pi, sin

from estimator.compiled import compiled
from estimator.conditioning.bias import limited, update
from estimator.conditioning.magnetic import LEAST_HORIZONTAL
from estimator.conditioning.types import BiasState, ConditioningParams, MagneticState
from estimator.types import Vec3

LEAST_CONFIDENCE = 1e-6


@compiled
def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi]."""
    if angle > pi:
        return angle - 2.0 * pi
    if angle < -pi:
        return angle + 2.0 * pi
    return angle


@compiled
def field_north_east(heading: float, field_6d: Vec3) -> tuple[float, float]:
    """North and east part of the field, the 6D frame turned about down by ``heading``."""
    c = cos(heading)
    s = sin(heading)
    return (c * field_6d[0] - s * field_6d[1], s * field_6d[0] + c * field_6d[1])


@compiled
def residual(field: MagneticState, north: float, east: float) -> float:
    """How far the field points east of north: linear in its east part, an angle when large.

    A disturbance adds to the field, so its effect on east/reference is linear
    and averages out where that on the angle does not.
    """
    if north < 0.5 * abs(east):
        return atan2(east, north)
    return east / field.horizontal_reference


@compiled
def learn_heading(
    params: ConditioningParams,
    state: BiasState,
    field: MagneticState,
    off: float,
    dt_s: float,
) -> BiasState:
    """Scalar update of heading and bias by the residual -off, of noise R/(dt c)."""
    confidence = max(field.confidence, LEAST_CONFIDENCE)
    noise = params.heading_noise_rad2_s / (dt_s * confidence)
    b, d, p = update(
        state.bias_rad_s,
        state.heading_rad,
        state.covariance,
        (0.0, 0.0, 0.0),
        1.0,
        -off,
        noise,
    )
    return BiasState(
        limited(b, params.bias_limit_rad_s),
        wrapped(d),
        p,
        state.rows,
        state.rows_slope,
        state.drift,
        state.drift_slope,
    )


@compiled
def has_heading(field: MagneticState) -> bool:
    """Whether the learnt field has a horizontal part that can tell a heading."""
    return field.horizontal_reference > LEAST_HORIZONTAL * abs(field.down_reference)
