"""A learning step of field, calibration and heading from mean readings."""

from math import atan2, cos, pi, sin
from typing import NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.calibration import CalibrationState, learn_calibration
from estimator.conditioning.field.magnetic import (
    MagneticState,
    has_heading,
    observe_field,
    reference_norm,
    residual_factor,
    steepness,
)
from estimator.conditioning.params import MEMORY_S, SPAN_S, ConditioningParams
from estimator.conditioning.vertical.bias import Estimate, clip_each, update
from estimator.conditioning.vertical.gravity import heading_frame
from estimator.conditioning.vertical.step import VerticalStep
from estimator.conditioning.vertical.tilt import slowness, weighing
from estimator.geometry.axes import axes_of
from estimator.geometry.quaternion import rotate
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
def heading_noise(params: ConditioningParams, field: MagneticState, settled: float) -> float:
    """Density R (rad^2 s) of the error of the field's heading.

    R = R_0 (1 + T/(1 s + age)) + R_c (1/c - 1). Under optical truth the error of good magnetometers
    decorrelates within two seconds and counts as white: means of 3 to 20 s scatter as a density of
    1e-4 to 5e-3 does. It is larger while own field and lag are being learnt, T, and if norm or dip
    are off, c < 1.
    """
    confidence = max(field.look.confidence * settled, TINY)
    early = 1.0 + MEMORY_S / (SPAN_S + field.reference.age_s)
    uncertain = params.heading_inflation_noise_rad2_s * (1.0 / confidence - 1.0)
    return params.heading_noise_rad2_s * early + uncertain


@inlined
def learn_heading(
    params: ConditioningParams,
    estimate: Estimate,
    field: MagneticState,
    horizontal: Vec2,
    settled: float,
    dt_s: float,
    tilt_variance: float,
) -> Estimate:
    """Scalar update of heading and bias by minus the residual, of variance R/dt.

    A new vertical turns the horizontal field, so ``settled`` lowers the confidence. A vertical that
    is uncertain by ``tilt_variance`` (rad^2) does so, too, the more the steeper the field.
    """
    noise = heading_noise(params, field, settled) / dt_s
    noise += tilt_variance * steepness(field.reference)
    north, east = horizontal
    # a disturbance adds to the field, so that its effect on the east part averages out, and that
    # on the angle does not
    off = atan2(east, north) if north < 0.5 * abs(east) else east / field.reference.horizontal
    b, d, p = estimate
    noise *= residual_factor(off, p[9])
    b, d, p = update(b, d, p, ZERO_VEC3, 1.0, -off, noise)
    return Estimate(clip_each(b, estimate.bias_rad_s), wrap_angle(d), p)


# Weight of a field turned by a vertical that has just begun.
LEAST_SETTLED = 0.1


class MagnetometerState(NamedTuple):
    """What is known of the field and of the magnetometer."""

    calibration: CalibrationState  # of the magnetometer
    magnetic: MagneticState = MagneticState()  # the field and its reference


class FieldStep(NamedTuple):
    """The field's state after a learning step, and what it shows to the events."""

    state: MagnetometerState
    estimate: Estimate  # of bias and heading, after the field
    horizontal: Vec2  # its north and east part before that, in its own unit; (1, 0) without one
    since_s: float  # since the field before


@inlined
def learn_field(
    params: ConditioningParams, before: MagnetometerState, vertical: VerticalStep
) -> FieldStep:
    """Calibration, confidence and heading by one step's mean field, if there is one."""
    horizontal = (1.0, 0.0)
    now, mean, estimate = vertical.state, vertical.mean, vertical.state.estimate
    since_s = before.magnetic.wait_s + mean.time_s
    if mean.field_s <= 0.0:
        waiting = before._replace(magnetic=before.magnetic._replace(wait_s=since_s))
        return FieldStep(waiting, estimate, horizontal, since_s)
    gravity, calibration = now.gravity, before.calibration
    field_6d = rotate(heading_frame(gravity, now.averaging.share), mean.field_g)
    settled = max(LEAST_SETTLED, min(1.0, gravity.force.age_s / params.gravity_tau_s) ** 2)
    magnetic = observe_field(params, before.magnetic, field_6d, since_s, settled)
    n = reference_norm(magnetic)
    unseen = slowness(params, mean.time_s) * now.tilt.variance
    if n > 0.0:
        axes = axes_of(mean.q_g_frd)
        calibration = learn_calibration(
            params, calibration, axes, vertical.rate, mean.field_g, n, since_s, unseen
        )
    if has_heading(magnetic):
        horizontal = north_east(estimate.heading_rad, field_6d)
        tilt_variance = 0.5 * (weighing(params, mean.time_s) * now.tilt.variance + now.inflation)
        estimate = learn_heading(
            params, estimate, magnetic, horizontal, settled, since_s, tilt_variance
        )
    return FieldStep(MagnetometerState(calibration, magnetic), estimate, horizontal, since_s)
