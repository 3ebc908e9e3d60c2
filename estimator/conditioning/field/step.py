"""A learning step of the field wing: what a mean reading of the magnetic field teaches."""

from typing import NamedTuple

from estimator.compilation.compiled import inlined
from estimator.compilation.replacing import replacer
from estimator.conditioning.field.calibration import CalibrationState, learn_calibration
from estimator.conditioning.field.heading import learn_heading, north_east
from estimator.conditioning.field.magnetic import (
    MagneticState,
    has_heading,
    observe_field,
    reference_norm,
    with_wait,
)
from estimator.conditioning.gather import Gathered
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.vertical.bias import Estimate
from estimator.conditioning.vertical.gravity import heading_frame
from estimator.conditioning.vertical.step import VerticalStep
from estimator.conditioning.vertical.tilt import slowness, weighing
from estimator.geometry.axes import axes_of
from estimator.geometry.quaternion import rotate
from estimator.types import Vec2

# Weight of a field turned by a vertical that has just begun.
LEAST_SETTLED = 0.1


class MagnetometerState(NamedTuple):
    """What is known of the field and of the magnetometer."""

    calibration: CalibrationState  # of the magnetometer
    magnetic: MagneticState = MagneticState()  # the field and its reference


class FieldStep(NamedTuple):
    """What a learning step has taught the field wing, and what it tells the events."""

    state: MagnetometerState
    estimate: Estimate  # of bias and heading, with what the field has told about them
    seen: bool  # whether there was a field
    horizontal: Vec2  # its north and east part before that, in its own unit; (1, 0) without one
    since_s: float  # since the field before


with_magnetic = replacer(MagnetometerState, "magnetic")


@inlined
def learn_field(
    params: ConditioningParams, before: MagnetometerState, mean: Gathered, vertical: VerticalStep
) -> FieldStep:
    """Calibration, confidence and heading by one step's mean field, if there is one."""
    horizontal = (1.0, 0.0)
    now, estimate = vertical.state, vertical.state.estimate
    since_s = before.magnetic.wait_s + mean.time_s
    if mean.field_s <= 0.0:
        waiting = with_magnetic(before, with_wait(before.magnetic, since_s))
        return FieldStep(waiting, estimate, False, horizontal, since_s)
    gravity, calibration = now.gravity, before.calibration
    field_6d = rotate(heading_frame(gravity, now.averaging.share), mean.field_g)
    settled = max(LEAST_SETTLED, min(1.0, gravity.force.age_s / params.gravity_tau_s) ** 2)
    magnetic = observe_field(params, before.magnetic, field_6d, since_s, settled)
    n = reference_norm(magnetic)
    unseen = slowness(params, mean.time_s) * now.tilt.variance
    if n > 0.0:
        axes = axes_of(gravity.q_g_frd)
        calibration = learn_calibration(
            params, calibration, axes, vertical.rate, mean.field_g, n, since_s, unseen
        )
    if has_heading(magnetic):
        horizontal = north_east(estimate.heading_rad, field_6d)
        leaning = 0.5 * (weighing(params, mean.time_s) * now.tilt.variance + now.inflation)
        estimate = learn_heading(params, estimate, magnetic, horizontal, settled, since_s, leaning)
    return FieldStep(MagnetometerState(calibration, magnetic), estimate, True, horizontal, since_s)
