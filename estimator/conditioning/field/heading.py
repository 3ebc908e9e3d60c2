"""The heading correction from the horizontal field."""

from math import atan2, cos, pi, sin

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.magnetic import MagneticState, steepness
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.robust import residual_factor
from estimator.conditioning.times import MEMORY_S, SPAN_S
from estimator.conditioning.vertical.bias import MOST_BIAS_RAD_S, Estimate, clip_each
from estimator.conditioning.vertical.kalman import update
from estimator.types import ZERO_VEC3, Vec2, Vec3


@inlined
def wrap_angle(angle: float) -> float:
    """An angle of at most one and a half turns, brought into [-pi, pi]."""
    if angle > pi:
        return angle - 2.0 * pi
    if angle < -pi:
        return angle + 2.0 * pi
    return angle


@inlined
def north_east(heading: float, field_6d: Vec3) -> Vec2:
    """North and east part of the field, 6D turned about down by ``heading``."""
    c = cos(heading)
    s = sin(heading)
    return (c * field_6d[0] - s * field_6d[1], s * field_6d[0] + c * field_6d[1])


@inlined
def residual(field: MagneticState, horizontal: Vec2) -> float:
    """How far the field points east of north: linear in its east part, an angle when large.

    A disturbance adds to the field, so its effect on east/reference is linear
    and averages out where that on the angle does not. The dip does not leak
    in, as it does into the cross product of whole fields.
    """
    north, east = horizontal
    if north < 0.5 * abs(east):
        return atan2(east, north)
    return east / field.reference.horizontal


@inlined
def heading_noise(params: ConditioningParams, field: MagneticState, settled: float) -> float:
    """Density R (rad^2 s) of the error of the field's heading.

    R = R_0 (1 + T/(1 s + age)) + R_c (1/c - 1). Under optical truth the error of good
    magnetometers decorrelates within a second or two, so it counts as white: its means of 3 to
    20 s scatter as a density of 1e-4 to 5e-3 does. It is larger while an own field and a lag are
    being learnt, T, and where norm and dip are off, c < 1.
    """
    confidence = max(field.look.confidence * settled, TINY)
    early = 1.0 + MEMORY_S / (SPAN_S + field.reference.age_s)
    doubtful = params.heading_doubt_noise_rad2_s * (1.0 / confidence - 1.0)
    return params.heading_noise_rad2_s * early + doubtful


@inlined
def learn_heading(
    params: ConditioningParams,
    estimate: Estimate,
    field: MagneticState,
    horizontal: Vec2,
    settled: float,
    dt_s: float,
    leaning: float,
) -> Estimate:
    """Scalar update of heading and bias by minus the residual, of variance R/dt.

    ``settled`` lowers the confidence while the vertical itself is new: a tilted 6D turns the
    horizontal field. So does one that is uncertain by ``leaning`` (rad^2), the more the
    steeper the field.
    """
    noise = heading_noise(params, field, settled) / dt_s
    noise += leaning * steepness(field.reference)
    off = residual(field, horizontal)
    b, d, p = estimate
    noise *= residual_factor(off, p[9])
    b, d, p = update(b, d, p, ZERO_VEC3, 1.0, -off, noise)
    return Estimate(clip_each(b, MOST_BIAS_RAD_S, estimate.bias_rad_s), wrap_angle(d), p)
