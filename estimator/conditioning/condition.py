"""The conditioning stage: from one IMU sample to the paper's vectors."""

from math import cos, sin

from estimator.compilation.compiled import compiled, inlined
from estimator.conditioning.calibration import correct_field
from estimator.conditioning.certainty import certainty_of, with_certainty
from estimator.conditioning.clipping import watch_clipping
from estimator.conditioning.coefficients import coefficients
from estimator.conditioning.gather import STEP_S, gather
from estimator.conditioning.gravity import propagate_frame, rows_of, to_body, to_frame
from estimator.conditioning.initial import initial_state
from estimator.conditioning.learning import learn
from estimator.conditioning.rate import at_interval_end, integration_rate
from estimator.conditioning.rest import initial_rest
from estimator.conditioning.tilt import initial_tilt, slowness
from estimator.conditioning.types import Conditioned, ConditioningParams, ConditioningState, Rows
from estimator.geometry.quaternion import (
    conjugate,
    exp,
    log,
    multiply,
    rotate_inverse,
    scale,
    subtract,
)
from estimator.types import Quaternion, Sample, Vec3

__all__ = ["condition", "initial_state"]

LEAST_DT_S = 1e-6


@inlined
def ned_of_g(state: ConditioningState) -> Quaternion:
    """From G to north, east and down, as far as they are known."""
    half = 0.5 * state.estimate.heading_rad
    return multiply((cos(half), 0.0, 0.0, sin(half)), state.gravity.q_6d_g)


@inlined
def rate_by_attitudes(
    state: ConditioningState, rate: Vec3, before: Quaternion, slow: float, dt_s: float
) -> Vec3:
    """The rate that makes of the attitude before a slow step the one after it.

    exp(w' dt) = exp(w dt) exp(phi) with phi the step's correction seen from the
    body: what gyroscope and vectors together say the vehicle has turned.
    """
    correction = log(multiply(conjugate(before), ned_of_g(state)))
    phi = scale(slow, rotate_inverse(state.gravity.q_g_frd, correction))
    return scale(1.0 / dt_s, log(multiply(exp(scale(dt_s, rate)), exp(phi))))


@compiled
def condition(
    params: ConditioningParams, state: ConditioningState, sample: Sample
) -> tuple[ConditioningState, Conditioned]:
    """Take one sample, of which the field may be in any unit."""
    gyr, acc, mag = sample.gyr_rad_s, sample.acc_m_s2, sample.mag
    # Before the first sample there was no interval; what it tells counts as one step's.
    dt = max(sample.dt_s, LEAST_DT_S) if state.started else STEP_S
    previous = state.previous_gyr_rad_s if state.started else gyr
    rate = integration_rate(previous, gyr, dt, params.averaged_samples)
    if sample.between.given:
        rate = sample.between.turn_rad_s
    rate = subtract(subtract(rate, state.estimate.bias_rad_s), state.spin.drift_rad_s)
    if params.averaged_samples:
        acc = at_interval_end(acc, gyr, dt)
        mag = at_interval_end(mag, gyr, dt)
    if sample.has_mag:
        mag = correct_field(mag, rate, state.calibration.learnt)
    turn = exp(scale(dt, rate))
    gravity = propagate_frame(state.gravity, turn)
    rows_g = rows_of(gravity.q_g_frd)
    corrected = Sample(
        gyr_rad_s=gyr,
        acc_m_s2=acc,
        mag=mag,
        has_mag=sample.has_mag,
        dt_s=dt,
        between=sample.between,
    )
    gathered = gather(state.gathered, rows_g, corrected)
    first = not state.started
    k = state.coefficients
    usual_s = k.dt_s
    due = first or gathered.time_s >= STEP_S
    clipping = watch_clipping(state.clipping, state.previous_gyr_rad_s, gyr, dt)
    if due and (gathered.time_s != k.dt_s or state.averaging.factor != k.factor):
        k = coefficients(params, gathered.time_s, state.averaging.factor)
    rest, tilt = state.rest, state.tilt
    if first:
        rest = initial_rest(gyr, acc)
        tilt = initial_tilt(gyr, scale(-1.0, to_frame(rows_g, acc)))
    state = ConditioningState(
        started=True,
        previous_gyr_rad_s=gyr,
        gathered=gathered,
        clipping=clipping,
        spin=state.spin,
        averaging=state.averaging,
        gravity=gravity,
        tilt=tilt,
        rest=rest,
        estimate=state.estimate,
        lagged=state.lagged,
        magnetic=state.magnetic,
        calibration=state.calibration,
        signs=state.signs,
        doubt=state.doubt,
        axes=state.axes,
        certainty=state.certainty,
        coefficients=k,
    )
    if due:
        before = state
        state = learn(params, before, gyr, sample.between, usual_s)
        state = with_certainty(state, certainty_of(params, state))
        slow = 0.0 if first else slowness(params, dt)
        if slow > 0.0:
            rate = rate_by_attitudes(state, rate, ned_of_g(before), slow, dt)
            turn = exp(scale(dt, rate))
    return state, result_of(state, rows_g, rate, turn)


@inlined
def result_of(state: ConditioningState, rows_g: Rows, rate: Vec3, turn: Quaternion) -> Conditioned:
    """The result for the filter and the publisher."""
    axes, known = state.axes, state.certainty
    return Conditioned(
        rate_rad_s=rate,
        turn=turn,
        bias_rad_s=state.estimate.bias_rad_s,
        gravity_b=to_body(rows_g, axes.down_g),
        magnetic_b=to_body(rows_g, axes.north_g),
        weight=known.weight,
        has_heading=known.has_heading,
        gravity_confidence=known.gravity_confidence,
        magnetic_confidence=known.magnetic_confidence,
        sigma_inclination_rad=known.sigma_inclination_rad,
        sigma_heading_rad=known.sigma_heading_rad,
    )
