"""Turns that no gyroscope has felt: their sum against what the covariance expects of it."""

from math import e, hypot, radians, sqrt

import numpy as np
import pytest

from estimator.aiding import types
from estimator.aiding.beginning import blank_aiding
from estimator.aiding.correction_cusum import add_correction, known, pass_time
from estimator.aiding.uncertainty import with_dip_error
from estimator.conditioning.field.magnetic import FieldLook
from estimator.types import ZERO_VEC3
from tests.flight import banked_flight, changed, flown, north_known

PARAMS = types.AidingParams()
BLANK, _, _ = blank_aiding(PARAMS)
NOTHING = types.CorrectionCusum(ZERO_VEC3, ZERO_VEC3, 0.0, 0.0, 0.0)
KNOWN = np.zeros((types.SIZE, types.SIZE))
SIGMA = types.Sigmas(inclination_rad=0.01, heading_rad=0.02)
PLACE = (0.21, 0.01, 0.43)


def covariance(level, heading, bias=0.0):
    P = np.zeros((types.SIZE, types.SIZE))
    P[types.TURN, types.TURN] = P[types.TURN + 1, types.TURN + 1] = 0.5 * level
    P[types.TURN + 2, types.TURN + 2] = heading
    for i in range(types.GYR_BIAS, types.GYR_BIAS + 3):
        P[i, i] = bias
    return P


def test_a_bias_that_has_changed_turns_the_attitude_until_its_mean_has_followed():
    changed = BLANK.estimate._replace(gyr_bias_rad_s=(0.0, 0.0, 0.01))
    found, largest = NOTHING, 0.0
    for _ in range(3000):
        found = pass_time(PARAMS, found, changed, KNOWN, 0.1)
        largest = max(largest, abs(found.turn_rad[2]))
    assert largest == pytest.approx(0.01 * 30.0 / e, rel=0.01)
    assert abs(found.turn_rad[2]) < 0.02 * largest
    assert found.bias_rad_s[2] == pytest.approx(0.01, rel=1e-3)


def test_white_corrections_of_a_true_covariance_are_as_expected():
    """A Kalman filter of a walk: the sum's mean square is what is expected."""
    rng, found, ratios = np.random.default_rng(5), NOTHING, []
    true = estimate = 0.0
    variance, walk, noise = 0.01, 1e-5, 1e-3
    for _ in range(20_000):
        true, variance = true + sqrt(walk) * rng.standard_normal(), variance + walk
        gain = variance / (variance + noise)
        step = gain * (true + sqrt(noise) * rng.standard_normal() - estimate)
        before, variance = variance, (1.0 - gain) * variance
        estimate += step
        before, after = known(covariance(0.0, before)), known(covariance(0.0, variance))
        found = add_correction(
            pass_time(PARAMS, found, BLANK.estimate, KNOWN, 0.1), (0, 0, step), before, after
        )
        ratios.append(found.turn_rad[2] ** 2 / found.heading)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.25)
    assert np.mean(np.array(ratios) > 4.0) == pytest.approx(0.046, abs=0.03)


@pytest.mark.parametrize("dip_off_deg", [-25.0, 4.0, 20.0])
@pytest.mark.parametrize("strength", [1.0, 1.3])
def test_a_field_that_dips_otherwise_than_the_places_shows_a_tilted_vertical(dip_off_deg, strength):
    h, d = hypot(*PLACE[:2]), PLACE[2]
    turn = np.exp(1j * radians(dip_off_deg)) * complex(h, d) * strength
    look = FieldLook(horizontal=float(turn.real), down=float(turn.imag), confidence=0.0)
    P = np.zeros((types.SIZE, types.SIZE))
    P[types.HARD_IRON, types.HARD_IRON] = 0.01**2
    seen = BLANK.field._replace(look=look, samples=9.0)
    wide = with_dip_error(PARAMS, SIGMA, seen, PLACE, P)
    square = np.sin(radians(dip_off_deg)) ** 2 - radians(10.0) ** 2 - 9e-4 / (h * h + d * d)
    square = max(0.0, square) / (1.0 + ((strength - 1.0) / 0.1) ** 2) ** 2
    assert wide.inclination_rad == pytest.approx(hypot(0.01, sqrt(square)))
    assert wide.heading_rad == SIGMA.heading_rad
    assert with_dip_error(PARAMS, SIGMA, seen, ZERO_VEC3, P) == SIGMA


def test_an_accelerometer_that_steps_widens_sigma_within_a_second():
    first, last = 20_000_000, 40_000_000

    def step(sample, _):
        ax, ay, az = sample.acc_m_s2
        return sample._replace(acc_m_s2=(ax, ay + 3.0 * (first <= sample.time_us < last), az))

    attitudes = flown(north_known(), changed(banked_flight(bank_rad=0.0), step))
    beyond = [
        (abs(a.q_ned_frd[1]) * 2.0, a.sigma_inclination_rad)
        for a in attitudes
        if a.time_us >= first
    ]
    wrong, sigma = np.array(beyond).T
    assert wrong.max() > radians(10.0)
    assert np.mean(wrong > 3.0 * sigma) < 0.02
    at = {a.time_us: a for a in attitudes}
    assert at[first].sigma_inclination_rad < radians(1.0)
    assert at[first + 1_000_000].sigma_inclination_rad > radians(1.0)
