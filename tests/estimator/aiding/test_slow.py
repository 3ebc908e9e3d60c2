"""The aided stage at a ground station's rate: an attitude that velocity has lost."""

from math import degrees, radians

import numpy as np
import pytest

from estimator.aiding.inertial import Prediction
from estimator.aiding.sources.unaided import observe_slow_unaided
from estimator.aiding.types import SIZE, TURN
from estimator.geometry.quaternion import exp, rotate
from estimator.types import ZERO_VEC3, Quaternion, Vec3

UP: Vec3 = (0.0, 0.0, 1.0)


def corrected(tilt_deg: float, sigma_deg: float, unaided_sigma_deg: float) -> float:
    """The tilt (deg) of a level vehicle after one look at the unaided gravity."""
    q: Quaternion = exp((radians(tilt_deg), 0.0, 0.0))
    P = radians(sigma_deg) ** 2 * np.eye(SIZE)
    x = np.zeros(SIZE)
    trail = np.zeros((1, 1))
    now = Prediction(q, *(ZERO_VEC3,) * 5, trail, P)
    observe_slow_unaided(now, UP, radians(unaided_sigma_deg), x, 1.0, 0.4)
    down = rotate(exp((x[TURN], x[TURN + 1], x[TURN + 2])), rotate(q, UP))
    return degrees(np.arctan2(np.hypot(down[0], down[1]), down[2]))


def test_a_lost_attitude_follows_the_unaided_gravity_even_upside_down():
    assert corrected(20.0, 40.0, 2.0) == pytest.approx(0.277, rel=0.2)
    assert corrected(160.0, 60.0, 2.0) == pytest.approx(0.994, rel=0.2)


def test_an_attitude_that_velocity_knows_stays():
    """A lasting acceleration deceives the unaided gravity by more than its sigma says."""
    assert corrected(20.0, 1.0, 5.0) > 19.99


def test_an_uncertain_attitude_is_drawn_according_to_both_sigmas():
    assert corrected(20.0, 10.0, 5.0) == pytest.approx(12.2, rel=0.2)
