"""The vertical of slow streams: what a step misses, and how far the force counts."""

from math import degrees, radians

import numpy as np
import pytest

from estimator.conditioning.vertical.tilt import slowness
from estimator.geometry.quaternion import angle_between_vectors
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Sample
from tests.estimator.conditioning.motion import PARAMS, Stage

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
            yield stage.take(Sample(gyr, acc, ZERO_VEC3, False, dt))[0]

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
