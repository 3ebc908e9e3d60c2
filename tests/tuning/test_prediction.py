"""Vectors foretold by the gyroscope alone."""

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.live.rows import rows_of
from tuning.prediction import (
    AHEAD_S,
    heading_errors,
    levelling_errors,
    predicted_vectors,
    rms_known,
)

RATE_HZ = 100.0
N = 1000


def flight(noise=0.0, bias=0.0):
    flown = simulate(5, N, RATE_HZ, noise=noise, bias=bias)
    times_us, has_mag = 10_000 * np.arange(N), np.ones(N, dtype=bool)
    rows = rows_of(times_us, flown.gyr_rad_s, flown.acc_m_s2, flown.mag_gauss, has_mag)
    return rows, flown.q_ned_frd


def turned(q, angle_rad, axis):
    """exp(angle axis) q, the turn seen from NED."""
    a, (x, y, z) = np.cos(angle_rad / 2), np.sin(angle_rad / 2) * np.array(axis)
    turn = np.array([[a, -x, -y, -z], [x, a, -z, y], [y, z, a, -x], [z, -y, x, a]])
    return q @ turn.T


def errors(readings, q, bias=(0.0, 0.0, 0.0)):
    """RMS of level and heading, deg, and of how many samples there is a prediction."""
    down, field = predicted_vectors(readings, q, np.tile(bias, (N, 1)), 0)
    level, north = (rms_known(each) for each in (levelling_errors(down), heading_errors(field)))
    return np.degrees(level), np.degrees(north), int(np.isfinite(down[:, 0]).sum())


def test_the_truth_foretells_its_vectors_and_a_tilted_estimate_is_off_by_its_tilt():
    """Up to what 100 Hz integration misses of the turn in half a second."""
    readings, q = flight()
    level, north, count = errors(readings, q)
    assert max(level, north) < 0.6
    assert count == N - round(AHEAD_S * RATE_HZ)
    for angle_deg in (2.0, 10.0, 40.0):
        level, _, _ = errors(readings, turned(q, np.radians(angle_deg), (1.0, 0.0, 0.0)))
        assert level == pytest.approx(angle_deg, rel=0.02)


@pytest.mark.parametrize("bias_rad_s", [(0.2, 0.0, 0.0), (0.0, -0.2, 0.0), (0.12, 0.1, -0.15)])
def test_a_bias_that_is_not_named_shows_by_half_a_second_of_it(bias_rad_s):
    readings, q = flight()
    wrong = readings._replace(gyr_rad_s=readings.gyr_rad_s + bias_rad_s)
    assert max(errors(wrong, q, bias_rad_s)[:2]) < 0.6
    assert 1.7 < errors(wrong, q)[0] <= np.degrees(np.linalg.norm(bias_rad_s) * AHEAD_S)
