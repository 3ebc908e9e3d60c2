"""Vectors foretold by the gyroscope alone."""

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.geometry.rotations import exp, multiply
from estimator.live.rows import rows_of
from tuning.prediction import AHEAD_S, heading_errors, predicted_vectors

N = 1000
FLOWN = simulate(5, N, 100.0, noise=0.0, bias=0.0)
NO_BIAS = (0.0, 0.0, 0.0)


def errors(q=FLOWN.q_ned_frd, bias=NO_BIAS, named=NO_BIAS):
    """RMS of level and heading, deg, by a gyroscope with a bias and an estimate that names one."""
    vectors = (FLOWN.gyr_rad_s + bias, FLOWN.acc_m_s2, FLOWN.mag_gauss)
    rows = rows_of(10_000 * np.arange(N), *vectors, np.ones(N, dtype=bool))
    down, field = predicted_vectors(rows, q, np.tile(named, (N, 1)), 0)
    assert np.isfinite(down[:, 0]).sum() == N - round(AHEAD_S * 100.0)
    level = np.arctan2(np.hypot(*down.T[:2]), down[:, 2])
    return [np.degrees(np.sqrt(np.nanmean(e**2))) for e in (level, heading_errors(field))]


@pytest.mark.parametrize("angle_deg", [2.0, 10.0, 40.0])
def test_the_truth_foretells_its_vectors_and_a_tilted_estimate_is_off_by_its_tilt(angle_deg):
    """Up to what 100 Hz integration misses of the turn in half a second."""
    assert max(errors()) < 0.6
    tilted = multiply(exp(np.radians([[angle_deg, 0.0, 0.0]])), FLOWN.q_ned_frd)  # seen from NED
    assert errors(tilted)[0] == pytest.approx(angle_deg, rel=0.02)


@pytest.mark.parametrize("bias_rad_s", [(0.2, 0.0, 0.0), (0.0, -0.2, 0.0), (0.12, 0.1, -0.15)])
def test_a_bias_that_is_not_named_shows_by_half_a_second_of_it(bias_rad_s):
    assert max(errors(bias=bias_rad_s, named=bias_rad_s)) < 0.6
    most = np.degrees(np.linalg.norm(bias_rad_s) * AHEAD_S)
    assert 1.7 < errors(bias=bias_rad_s)[0] <= most
