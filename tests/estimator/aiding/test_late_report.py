"""A velocity report is worth the same before the sample that it belongs to and behind it."""

import numpy as np
import pytest

from estimator.aiding.phase import Phase
from estimator.estimator import Estimator
from estimator.profile import load_profile, merge_profile
from estimator.types import VelocitySample
from tests.flight import banked_flight

TRUE_NORTH = {"reference": {"declination_deg": 0.0}}
SAMPLES = 480  # 9.6 s at 50 Hz: in the first banked turn


@pytest.fixture(scope="module")
def flying():
    """A flight, and the state in its turn."""
    flight = banked_flight(seconds=10.0)
    behind = dict(flight.reports)
    estimator = Estimator(merge_profile(load_profile("imu"), TRUE_NORTH))
    for k, sample in enumerate(flight.samples[:SAMPLES]):
        estimator.update(sample)
        if k in behind:
            estimator.update_velocity(behind[k])
    assert estimator.snapshot.context.phase is Phase.AIDED
    return flight, estimator.profile, estimator.snapshot


def numbers(snapshot):
    """Every estimate of the aiding, one after the other."""
    parts = [np.atleast_1d(np.asarray(part)) for part in snapshot.core.aided.estimate]
    return np.concatenate(parts)


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
