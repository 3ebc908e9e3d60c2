"""The vertical of slow streams: what a step misses, and how far the force counts."""

from math import degrees, pi, radians

import numpy as np
import pytest

from estimator.conditioning.vertical.tilt import slowness
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.metrics import rms
from estimator.geometry.quaternion import angle_between_vectors, rotate_inverse
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3
from estimator.types import Sample as Reading
from tests.estimator.conditioning.motion import PARAMS, Sample, Stage, inclinations

FIXED = PARAMS._replace(use_step_noise=False, use_averaging=False)
LEVEL = (0.0, 0.0, -STANDARD_GRAVITY_M_S2)
DOWN = (0.0, 0.0, 1.0)


def test_a_stream_is_slow_by_its_steps_unless_they_are_averages():
    assert slowness(PARAMS, 1 / 25) == 0.0
    assert slowness(PARAMS, 1 / 15) == pytest.approx((1 / 15 - 0.04) / 0.11)
    assert slowness(PARAMS, 1 / 4) == 1.0
    assert slowness(PARAMS._replace(averaged_samples=True), 1 / 4) == 0.0
    assert slowness(FIXED, 1 / 4) == 0.0


def test_after_a_hole_with_a_fast_turn_a_vehicle_at_rest_is_upright_within_two_seconds():
    times = np.concatenate([np.arange(0.0, 20.0, 0.4), [21.0], np.arange(22.0, 30.0, 0.4)])

    def seen_by(params):
        stage = Stage(params)
        for time_s, dt in zip(times, np.diff(times, prepend=0.0).tolist(), strict=True):
            gyr, acc = ZERO_VEC3, LEVEL
            if time_s == 21.0:
                gyr, acc = (radians(-154.0), 0.0, 0.0), (4.0, -4.0, -11.0)
            yield stage.take(Reading(gyr, acc, ZERO_VEC3, False, dt))[0]

    seen, fixed = [*seen_by(PARAMS)], [*seen_by(FIXED)]
    off = np.degrees([angle_between_vectors(s.gravity_b, DOWN) for s in seen])
    sigma = np.degrees([s.sigma_inclination_rad for s in seen])
    in_hole = int(np.flatnonzero(times == 21.0)[0])
    assert sigma[in_hole - 1] == pytest.approx(0.633, rel=0.2)
    assert sigma[in_hole] == pytest.approx(14.8, rel=0.2)
    assert off[times >= 24.0].max() < 0.01  # measured 0.0014
    assert sigma[times >= 26.0].max() == pytest.approx(5.82, rel=0.2)
    off_fixed = degrees(angle_between_vectors(fixed[in_hole + 1].gravity_b, DOWN))
    assert off_fixed == pytest.approx(119.0, rel=0.2)


SLOW_S = 0.6


def in_vehicle(tilt_rad, shaken_m_s2):
    """Errors and sigmas of the inclination from 20 s on; after a rest any rate at all is shown."""
    rng = np.random.default_rng(1)

    def sample(k):
        t, moves = SLOW_S * k, SLOW_S * k > 10.0
        wobble = radians(4.0) * rng.standard_normal(2) * moves
        q = from_euler_rad(tilt_rad(t) + wobble[0], wobble[1], 0.3)
        gyr = tuple((3.0 * moves * rng.standard_normal(3)).tolist())
        acc = rotate_inverse(q, LEVEL) + (shaken_m_s2 * moves + 0.02) * rng.standard_normal(3)
        return Sample(q, gyr, tuple(acc.tolist()), has_mag=False)

    params = PARAMS._replace(in_vehicle=True)
    return inclinations(map(sample, range(200)), SLOW_S, params)[:, round(20.0 / SLOW_S) :]


def test_a_shaken_vehicle_is_held_at_its_usual_tilt():
    error, sigma = in_vehicle(lambda _t: radians(10.0), 6.0)
    assert rms(error) < 19.0
    assert np.mean(error < sigma) > 0.8


def test_the_vertical_of_a_vehicle_that_tilts_follows_its_force():
    error, sigma = in_vehicle(lambda t: 1.2 * np.sin(2.0 * pi * t / 40.0) * (t > 10.0), 0.3)
    assert rms(error) < 3.2
    assert np.mean(error < sigma) > 0.8
