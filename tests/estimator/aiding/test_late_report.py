"""A velocity report is worth the same before the sample that it belongs to and behind it."""

import numpy as np
import pytest

from estimator.aiding.types import AidingParams
from estimator.estimator import Estimator
from estimator.types import VelocitySample
from tests.flight import banked_flight, north_known, taken_along

SAMPLES = 480  # 9.6 s at 50 Hz: in the first banked turn


@pytest.fixture(scope="module")
def flying():
    """A flight, and the state in its turn."""
    flight = banked_flight(seconds=10.0)
    estimator = taken_along(north_known(), flight, SAMPLES)
    return flight, estimator.profile, estimator.snapshot


def numbers(snapshot):
    """Every estimate of the aiding and the velocities reported, one after the other."""
    aided = snapshot.core.aided
    reported = aided.acceleration_tilt.reported_m_s, aided.acceleration_tilt.latest_m_s
    parts = [np.atleast_1d(np.asarray(part)) for part in (*aided.estimate, *reported)]
    return np.concatenate(parts)


def learnt_from(flying, **changes):
    """The numbers after one more sample and a report."""
    flight, profile, state = flying
    time_us = flight.samples[SAMPLES].time_us
    report = VelocitySample(time_us, (3.0, 19.0, 0.3), True, 0.3)._replace(**changes)
    estimator = Estimator(profile)
    estimator.snapshot = state
    estimator.update_velocity(report)
    estimator.update(flight.samples[SAMPLES])
    return numbers(estimator.snapshot)


@pytest.mark.parametrize("late_sigma_s", [0.0, 0.1])
def test_before_or_behind_its_sample(flying, late_sigma_s):
    flight, profile, state = flying
    sample = flight.samples[SAMPLES]._replace(has_mag=False, mag_gauss=(0.0, 0.0, 0.0))
    report = VelocitySample(sample.time_us, (3.0, 19.0, 0.3), True, 0.3, late_sigma_s)
    after = {}
    for when in ("never", "before", "behind"):
        estimator = Estimator(profile)
        estimator.snapshot = state
        if when == "before":
            estimator.update_velocity(report)
        estimator.update(sample)
        if when == "behind":
            estimator.update_velocity(report)
        after[when] = numbers(estimator.snapshot)
    learnt = after["before"] - after["never"]
    assert np.abs(learnt).max() == pytest.approx(18.0, rel=0.2)  # m/s; measured 18.3 and 17.4
    np.testing.assert_allclose(after["behind"], after["before"], rtol=1e-12, atol=1e-15)


def test_a_report_that_claims_to_be_better_than_a_receiver_can_be_is_worth_no_more(flying):
    least = AidingParams().report_sigma_m_s
    usual = learnt_from(flying, sigma_m_s=least)
    assert np.array_equal(learnt_from(flying, sigma_m_s=0.1 * least), usual)
    assert not np.allclose(learnt_from(flying, sigma_m_s=3.0 * least), usual)


def test_a_report_without_its_vertical_teaches_nothing_by_it(flying):
    one, other = (
        learnt_from(flying, velocity_ned_m_s=(3.0, 19.0, down), has_vertical=False)[:-6]
        for down in (0.3, 9.0)
    )
    assert np.array_equal(one, other)
    assert not np.allclose(one, learnt_from(flying)[:-6])
