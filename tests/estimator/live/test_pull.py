"""A magnet that raw vectors follow shows in heading's sigma, as the gyroscope did not turn."""

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import load_profile
from fuzzbee import Estimator


def heading_scores(motion, magnet):
    """Heading's errors and sigmas (deg) by the paper's profile, seed 3, from 9.5 to 25 s."""
    recording = simulate(3, 2500, motion=motion, magnet=magnet)
    attitudes = Estimator(load_profile("paper"), rate_hz=100.0).update_batch(
        recording.gyr_rad_s, recording.acc_m_s2, recording.mag_gauss
    )
    errors = batch_angle_errors(attitudes.q_ned_frd, recording.q_ned_frd)[:, 1]
    return np.degrees(errors[950:]), np.degrees(attitudes.sigma_heading_rad[950:])


@pytest.mark.parametrize(
    ("motion", "worst", "sigma_there", "coverage"),
    [("paper", 54.7, 56.0, 0.98), ("rest", 79.5, 71.8, 0.70), ("turn", 177.6, 171.2, 0.88)],
)
def test_a_magnet_is_in_sigma(motion, worst, sigma_there, coverage):
    errors, sigmas = heading_scores(motion, (10.0, 20.0))
    k = np.argmax(errors)
    assert (errors[k], sigmas[k]) == pytest.approx((worst, sigma_there), rel=0.2)
    assert np.mean(errors <= sigmas) == pytest.approx(coverage, rel=0.2)


def test_without_a_magnet_sigma_is_little_wider():
    errors, sigmas = heading_scores("rest", None)
    assert np.mean(sigmas) == pytest.approx(12.0, rel=0.2)
    assert np.mean(errors <= sigmas) == 1.0
