"""Rows of samples and reports are the same estimator as one call after another, to the last bit."""

from pathlib import Path

import numpy as np
import pytest

from estimator.errors import InputError
from estimator.profile import load_profile
from fuzzbee import replay
from fuzzbee.tune.read_flight import read_flight
from tuning.flight import fly

LOGS = sorted(
    path
    for path in (Path(__file__).parents[1] / "data").iterdir()
    if path.suffix in (".tlog", ".ulg", ".bin")
)


@pytest.mark.parametrize("path", LOGS, ids=lambda path: path.name)
def test_a_log_in_rows_says_what_its_replay_says(path):
    """Replay takes each sample and report by itself, as the live service does."""
    profile = load_profile("imu")
    try:
        flight = read_flight(path, profile, "autopilot")
    except InputError:
        flight = read_flight(path, profile)
    course = fly(flight, profile, len(flight.truth))
    one_by_one = replay(path, profile).attitudes
    assert np.array_equal(course.q_ned_frd, one_by_one.q_ned_frd)
    assert np.array_equal(course.bias_rad_s, one_by_one.gyro_bias_rad_s)
    assert np.array_equal(course.sigma_rad[:, 0], one_by_one.sigma_inclination_rad)
    assert np.array_equal(course.sigma_rad[:, 1], one_by_one.sigma_heading_rad)
