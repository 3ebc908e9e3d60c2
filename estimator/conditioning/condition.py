"""The conditioning stage: from one IMU sample to the paper's vectors."""

from math import cos, sin
from typing import Any, NamedTuple

from estimator.bounds import TINY
from estimator.compilation.compiled import inlined
from estimator.conditioning.events.step import learn_events
from estimator.conditioning.field.calibration import Calibration, correct_field
from estimator.conditioning.field.step import learn_field
from estimator.conditioning.gather import STEP_S, Gathered, gather, means, start_again
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.rate import (
    at_interval_end,
    corrected_rate,
    integration_rate,
    is_mean,
    watch_clipping,
)
from estimator.conditioning.sigma import certainty_of
from estimator.conditioning.state import ConditioningState
from estimator.conditioning.vertical.gravity import level_to
from estimator.conditioning.vertical.step import VerticalState, begin_vertical, learn_vertical
from estimator.conditioning.vertical.tilt import slowness
from estimator.geometry.axes import axes_of, down_of, to_body
from estimator.geometry.quaternion import (
    conjugate,
    exp,
    log,
    multiply,
    normalize,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.types import IDENTITY, ZERO_VEC3, Between, Quaternion, Sample, Vec3


class Conditioned(NamedTuple):
    """The paper's vectors, and what else the filter and the publisher need.

    The last fields are those of a :class:`~estimator.conditioning.sigma.Certainty`.
    """

    rate_rad_s: Vec3 = ZERO_VEC3  # free of bias, the one that integrates best over the step; FRD
    turn: Quaternion = IDENTITY  # by that rate: the body's attitude after the step in that before
    bias_rad_s: Vec3 = ZERO_VEC3  # of the gyroscope, FRD
    gravity_b: Vec3 = (0.0, 0.0, 1.0)  # down, a unit vector in FRD
    magnetic_b: Vec3 = (1.0, 0.0, 0.0)  # magnetic north, horizontal, a unit vector in FRD
    has_heading: bool = False  # whether a field has shown it
    gravity_confidence: float = 0.0  # 0..1, falls with accelerations
    magnetic_confidence: float = 0.0  # 0..1, of the present field; 0 without one
    sigma_inclination_rad: float = 0.0  # angle that 68 % of the errors lie under
    sigma_brief_rad: float = 0.0  # the same if no acceleration lasted
    sigma_heading_rad: float = 0.0  # likewise; infinite without a heading


@inlined
def condition(handle: Any, sample: Sample) -> Conditioned:
    """Take one sample, of which the field may be in any unit.

    ``handle`` has ``params.conditioning``, what was ``gathered``, and the state, ``conditioning``.
    Only learning steps write that: to gather a fast stream's samples takes far less time.
    """
    params, is_first = handle.params.conditioning, not handle.conditioning.started
    # Before the first sample there was no interval; what it shows counts as half a step's.
    dt = 0.5 * STEP_S if is_first else max(sample.dt_s, TINY)
    gyr, gyr_before = sample.gyr_rad_s, handle.gathered.gyr_rad_s
    rate = integration_rate(gyr if is_first else gyr_before, gyr, dt, params.averaged_samples)
    if sample.between.given:
        rate = sample.between.turn_rad_s
    rate = subtract(rate, handle.conditioning.vertical.estimate.bias_rad_s)
    turn = exp(scale(dt, rate))
    handle.gathered = handle.gathered._replace(
        q_g_frd=normalize(multiply(handle.gathered.q_g_frd, turn)),
        gyr_rad_s=gyr,
        clipping=watch_clipping(handle.gathered.clipping, gyr_before, gyr, dt),
    )
    axes_g = axes_of(handle.gathered.q_g_frd)
    learnt = handle.conditioning.field.calibration.learnt
    at_end = at_step_end(params, learnt, sample._replace(dt_s=dt), rate, is_first)
    handle.gathered = gather(handle.gathered, axes_g, at_end)
    if is_first:
        begun = begin_vertical(handle.conditioning.vertical, handle.gathered.q_g_frd, at_end)
        handle.conditioning = handle.conditioning._replace(vertical=begun)
    if is_first or handle.gathered.time_s >= STEP_S:
        before = handle.conditioning.vertical
        handle.conditioning = learn(params, handle.conditioning, handle.gathered, sample.between)
        handle.gathered = start_again(handle.gathered)
        slow = 0.0 if is_first else slowness(params, dt)
        if slow > 0.0:
            # the rotation vector in the body by which the learning step has turned the vehicle
            turned = multiply(conjugate(ned_of_g(before)), ned_of_g(handle.conditioning.vertical))
            missed = rotate_inverse(handle.gathered.q_g_frd, log(turned))
            rate = corrected_rate(rate, missed, slow, dt)
            turn = exp(scale(dt, rate))
    bias_rad_s = handle.conditioning.vertical.estimate.bias_rad_s
    gravity_b = to_body(axes_g, handle.conditioning.down_g)
    magnetic_b = to_body(axes_g, handle.conditioning.north_g)
    certainty = handle.conditioning.certainty
    return Conditioned(rate, turn, bias_rad_s, gravity_b, magnetic_b, *certainty[:])


@inlined
def at_step_end(
    params: ConditioningParams, learnt: Calibration, sample: Sample, rate: Vec3, is_first: bool
) -> Sample:
    """The sample as read at the end of its step, by a compass that has been calibrated."""
    gyr, acc, mag, dt_s = sample.gyr_rad_s, sample.acc_m_s2, sample.mag, sample.dt_s
    if is_mean(dt_s, params.averaged_samples) and not is_first:
        acc = at_interval_end(acc, gyr, dt_s)
        if params.averaged_samples:
            mag = at_interval_end(mag, gyr, dt_s)
    if sample.has_mag:
        mag = correct_field(mag, rate, learnt)
    return sample._replace(acc_m_s2=acc, mag=mag)


@inlined
def learn(
    params: ConditioningParams, state: ConditioningState, gathered: Gathered, between: Between
) -> ConditioningState:
    """One learning step on what was gathered; ``between`` is known of the last sample's turning."""
    mean = means(gathered)
    force_scatter = state.events.gravity.force_scatter
    levelled = learn_vertical(params, state.vertical, mean, between, force_scatter)
    seen = learn_field(params, state.field, levelled)
    vertical, field, events = learn_events(params, state.events, levelled, seen)
    q = level_to(vertical.gravity.q_6d_g, vertical.gravity.force.best.value)[0]
    heading_rad = vertical.estimate.heading_rad
    north_g = rotate_inverse(q, (cos(heading_rad), -sin(heading_rad), 0.0))
    certainty = certainty_of(params, (vertical, field, events))
    return ConditioningState(vertical, field, events, True, down_of(q), north_g, certainty)


@inlined
def ned_of_g(vertical: VerticalState) -> Quaternion:
    """The rotation from G to north, east and down, as far as they are known."""
    half = 0.5 * vertical.estimate.heading_rad
    return multiply((cos(half), 0.0, 0.0, sin(half)), vertical.gravity.q_6d_g)
