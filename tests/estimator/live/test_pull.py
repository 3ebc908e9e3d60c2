"""A magnet that raw vectors follow shows in heading's sigma, as the gyroscope did not turn."""

from math import cos, sin

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.filter.types import initial_state
from estimator.geometry.metrics import batch_angle_errors
from estimator.live.published import NO_PULL, pulled
from estimator.profile import load_profile
from estimator.types import IDENTITY
from fuzzbee import Estimator

STEP_S = 0.01


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
    """By the error e alone sigma there was 12, 4 and 25 deg, its coverage 0.5, 0.5 and 0.4."""
    errors, sigmas = heading_scores(motion, (10.0, 20.0))
    k = np.argmax(errors)
    assert (errors[k], sigmas[k]) == pytest.approx((worst, sigma_there), rel=0.2)
    assert np.mean(errors <= sigmas) == pytest.approx(coverage, rel=0.2)


def test_without_a_magnet_sigma_is_little_wider():
    """By e alone 8.2 deg."""
    errors, sigmas = heading_scores("rest", None)
    assert np.mean(sigmas) == pytest.approx(12.0, rel=0.2)
    assert np.mean(errors <= sigmas) == 1.0


def follow(pull, rates_rad_s, biases_rad_s, turns_rad_s, error=0.0):
    """The pull while a body turns level as fast as the vectors say, not as the gyroscope does."""
    before = IDENTITY
    heading = 0.0
    for rate, bias, turn in zip(rates_rad_s, biases_rad_s, turns_rad_s, strict=True):
        heading += turn * STEP_S
        q = (cos(0.5 * heading), 0.0, 0.0, sin(0.5 * heading))
        state = initial_state(q)._replace(gyr_bias_rad_s=(0.0, 0.0, bias))
        pull = pulled(pull, before, state, (0.0, 0.0, rate), error, STEP_S)
        before = q
    return pull


def test_what_vectors_turn_alone_is_pulled_and_forgotten():
    one = np.ones(100)
    turned = follow(NO_PULL, 0.0 * one, 0.0 * one, 0.5 * one)
    assert turned.heading_rad == pytest.approx(0.5 * 20.0 * (1.0 - np.exp(-1.0 / 20.0)), rel=1e-3)
    later = follow(turned, *3 * [np.zeros(2000)])
    assert later.heading_rad == pytest.approx(np.exp(-1.0) * turned.heading_rad, rel=1e-3)


def test_a_turn_that_the_gyroscope_tells_or_sigma_foretold_is_none():
    one = np.ones(100)
    assert follow(NO_PULL, one, 0.0 * one, one).heading_rad == pytest.approx(0.0, abs=1e-12)
    assert follow(NO_PULL, 0.0 * one, 0.0 * one, one, error=0.5).heading_rad == 0.0


def test_only_a_bias_that_lasts_is_taken_off():
    """What a magnet makes of the filter's bias within a second is part of its pull."""
    one, rest = np.ones(100), np.zeros(2000)
    known = follow(NO_PULL, rest + 0.1, rest + 0.1, rest)
    assert known.heading_rad == pytest.approx(0.0, abs=1e-12)
    new = follow(known, 0.1 * one, 0.1 - 0.5 * one, 0.5 * one)
    assert new.heading_rad == pytest.approx(0.476, rel=0.01)
    assert new.bias_rad_s[2] == pytest.approx(0.1 - 0.5 * (1.0 - np.exp(-1.0 / 20.0)), rel=1e-3)
