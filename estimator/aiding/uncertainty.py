"""How far off the aided attitude may be: the angle that 68 % of the errors lie under."""

from math import sqrt

from estimator.aiding.types import TURN, Agreement, AidingParams, Array, FieldState
from estimator.compilation.compiled import inlined

# 68 % of a plane normal distribution lie within this many of its sigmas.
PLANE_68 = 1.515
LARGEST_SCALE = 4.0
LEAST_SCALE = 0.12
# Samples slower than this (s) scatter the field's residual by themselves.
QUICK_STEP_S = 0.15


@inlined
def inclination_sigma(
    params: AidingParams, P: Array, agreement: Agreement, turning_rad_s: float
) -> float:
    """From the covariance, scaled by how the reports really scatter, plus what no report shows."""
    least = LEAST_SCALE if agreement.wait_s <= params.silence_s else 1.0
    scale = min(max(params.colour * sqrt(agreement.scatter.innovation), least), LARGEST_SCALE)
    variance = 0.5 * (P[TURN, TURN] + P[TURN + 1, TURN + 1])
    aged = params.timing_s * turning_rad_s
    return sqrt((PLANE_68 * scale) ** 2 * variance + params.least_inclination_rad**2 + aged * aged)


@inlined
def heading_sigma(
    params: AidingParams,
    P: Array,
    agreement: Agreement,
    field: FieldState,
    iron_rad: float,
    turning_rad_s: float,
    dt: float,
) -> float:
    """Likewise, with the field's slow disagreement, which points to a wrong field.

    ``iron_rad`` is how far hard iron may turn the field. A heading that is no more certain than
    that comes from the field, and how well the reports agree says nothing about it.
    """
    scale = params.heading_colour * sqrt(agreement.scatter.innovation)
    scale = min(max(scale, params.least_heading_scale), LARGEST_SCALE)
    if field.samples == 0.0:
        scale *= params.bare_heading_colour
    disagreement = params.field_error_share**2 * field.residual.square
    if dt > QUICK_STEP_S:
        disagreement *= (QUICK_STEP_S / dt) ** 2
    aged = 0.5 * params.timing_s * turning_rad_s
    heading = P[TURN + 2, TURN + 2]
    by_field = min(1.0, heading / max(iron_rad * iron_rad, 1e-12))
    scale = scale * scale + (1.0 - min(1.0, scale * scale)) * params.iron_share**2 * by_field
    variance = scale * heading + disagreement
    return sqrt(variance + params.least_heading_rad**2 + aged * aged)
