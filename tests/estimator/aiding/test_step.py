"""A whole step of the aiding, and what was gained since a moment in the past."""

from math import cos, sin

import numpy as np
import pytest

from estimator.aiding import types
from estimator.aiding.beginning import Start, begin, blank_aiding
from estimator.aiding.correction import apply_corrections
from estimator.aiding.inertial import predict_motion
from estimator.aiding.sources.unaided import observe_unaided
from estimator.aiding.step import aid
from estimator.aiding.unseen import watch_turning
from estimator.aiding.velocity_history import (
    ROWS,
    extend_velocity_history,
    look_back,
    new_velocity_history,
)
from estimator.types import IDENTITY, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Sample

PARAMS = types.AidingParams()
STATE, _, HISTORY = blank_aiding(PARAMS)
OTHERS = types.StepInputs((0.1, -0.2, 0.97), 0.1, 0.0, types.North(False, (1.0, 0.0)))
SAMPLE = Sample((0.1, 0.2, -0.1), (0.5, -0.3, -9.7), ZERO_VEC3, False, 0.5)


def covariance():
    root = np.eye(types.SIZE) + 0.1 * np.random.default_rng(3).standard_normal(
        (types.SIZE, types.SIZE)
    )
    return 0.01 * root @ root.T


@pytest.mark.parametrize(
    ("dt_s", "wait_s", "push_m_s2"),
    [(0.5, 0.0, 1.0), (0.5, 3.0, 0.0), (0.02, 3.0, 3.0)],  # reported, not counted, felt
)
def test_a_step_that_is_slow_or_without_reports_is_corrected_once(dt_s, wait_s, push_m_s2):
    """The unaided gravity corrects it; there is no report and no field."""
    P, sample = covariance(), SAMPLE._replace(dt_s=dt_s)
    agreement = types.Agreements(*(each._replace(wait_s=wait_s) for each in STATE.agreement))
    acceleration_tilt = types.AccelerationTilt((3.0, 0.0, 0.0), (1.0, 1.0, 9.0), (2.5, 3.0, 0.0))
    state = STATE._replace(agreement=agreement, acceleration_tilt=acceleration_tilt)
    after, after_P, _ = aid(PARAMS, state, P, HISTORY, sample, types.NO_REPORT, OTHERS)
    now, x = predict_motion(PARAMS, state, P, HISTORY, sample), np.zeros(types.SIZE)
    if dt_s == 0.5:
        watch_turning(PARAMS, state, now.covariance, sample, 0.0)
    tilt_error_rad = push_m_s2 / STANDARD_GRAVITY_M_S2
    observe_unaided(now, OTHERS.gravity_b, 0.1, tilt_error_rad, x, 1.0, dt_s)
    assert np.abs(x[:3]).max() > 1e-4
    assert after.estimate == apply_corrections(now, x).estimate
    assert np.array_equal(after_P, now.covariance)


def test_a_step_remembers_the_velocity_of_its_report():
    report = types.Report(True, (1.0, -2.0, 0.5), True, 0.3, 0.0, 0.0)
    after, _, _ = aid(PARAMS, STATE, covariance(), HISTORY, SAMPLE, report, OTHERS)
    assert after.acceleration_tilt.latest_m_s == report.velocity_ned_m_s
    assert after.agreement.by_filter.wait_s == 0.0
    assert after.agreement.by_receiver.wait_s == SAMPLE.dt_s


def test_the_beginning_is_as_uncertain_as_given():
    """About north and east by the tilt's sigma, about down by the heading's."""
    first = Start(IDENTITY, 0.3, 0.1, hard_iron_sigma_gauss=0.02, field_lag_s=0.05)
    _, P, _ = begin(PARAMS, first, SAMPLE, types.NO_REPORT)
    assert np.diag(P)[:3] == pytest.approx([0.01, 0.01, 0.09])
    assert np.diag(P)[types.HARD_IRON : types.HARD_IRON + 3] == pytest.approx([0.0004] * 3)
    assert np.array_equal(P, np.diag(np.diag(P)))


PERIOD = 7.0  # rad/s of the swing


def velocity(t):
    return (sin(PERIOD * t), 2.0 * t, 0.5 * t * t)


def acceleration(t):
    return (PERIOD * cos(PERIOD * t), 2.0, t)


def flown(seconds, dt):
    velocity_history, t = new_velocity_history(acceleration(0.0)), 0.0
    while t < seconds - 1e-9:
        gained = tuple(b - a for a, b in zip(velocity(t), velocity(t + dt), strict=True))
        t += dt
        velocity_history = extend_velocity_history(velocity_history, gained, acceleration(t), dt)
    return velocity_history, t


def test_ahead_of_the_newest_sample_its_acceleration_goes_on():
    velocity_history, t = flown(1.0, 0.02)
    past = look_back(velocity_history, -0.01)
    assert past.gained_m_s == pytest.approx([-0.01 * a for a in acceleration(t)])


def test_before_the_history_begins_the_oldest_acceleration_goes_on():
    velocity_history, t = flown(0.1, 0.02)
    past = look_back(velocity_history, 0.3)
    wanted = np.subtract(velocity(t), velocity(0.0)) + np.multiply(0.2, acceleration(0.0))
    assert past.gained_m_s == pytest.approx(wanted, abs=1e-9)


def test_quick_samples_do_not_shorten_it():
    velocity_history, _ = flown(1.0, 0.0025)
    assert velocity_history[0, 0] - velocity_history[ROWS - 1, 0] > 0.5
