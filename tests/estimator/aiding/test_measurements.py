"""What the unaided gravity and the field count for, beside the dense filter's tests."""

import numpy as np
import pytest

from estimator.aiding.beginning import blank_aiding
from estimator.aiding.covariance import rotation_matrix
from estimator.aiding.inertial import Prediction
from estimator.aiding.sources import field
from estimator.aiding.types import (
    COMPASS_TURN,
    EARTH,
    HARD_IRON,
    SIZE,
    TURN,
    AidingParams,
    North,
    StepInputs,
)
from estimator.aiding.velocity_history import new_velocity_history
from estimator.conditioning.field.magnetic import FieldLook
from estimator.geometry.quaternion import normalize
from estimator.types import ZERO_VEC3, Sample

PARAMS = AidingParams()
BLANK, _, _ = blank_aiding(PARAMS)
BESIDE = StepInputs((0.0, 0.0, 1.0), 0.1, 0.0, North(is_known=True, direction=(1.0, 0.0)))


def test_declination_of_a_field_learnt_the_wrong_way_round():
    """The place's field may be learnt to point south while iron is: no saddle holds it there."""
    P, x = np.eye(SIZE), np.zeros(SIZE)
    field.learn_declination(P, x, (-0.2, 0.02, 0.42), (1.0, 0.0), 1.0)
    assert abs(x[EARTH + 1]) == pytest.approx(0.61, rel=0.2)


def prediction(q_ned_frd):
    """At rest with that attitude, of which nothing is known."""
    estimate = BLANK.estimate._replace(q_ned_frd=q_ned_frd)
    return Prediction(estimate, ZERO_VEC3, ZERO_VEC3, new_velocity_history(ZERO_VEC3), np.eye(SIZE))


@pytest.mark.parametrize("is_known", [True, False])
def test_a_field_begun_anew_hangs_together_with_all_that_is_known_of_the_iron(is_known):
    """Where north is not known, it points by heading and compass: a turn is an error of both."""
    rng = np.random.default_rng(2)
    root = rng.normal(scale=0.1, size=(SIZE, SIZE))
    P, R = root @ root.T, rotation_matrix(normalize(tuple(rng.normal(size=4))))
    iron, to_compass = P[HARD_IRON : HARD_IRON + 3].copy(), np.eye(SIZE)[TURN : TURN + 3]
    to_compass[:, COMPASS_TURN] = -R[:, 2]  # a turned compass sees the vehicle turned the other way
    turn = to_compass @ P
    seen, north = (0.12, 0.16, 0.42), North(is_known, (0.8, 0.6))
    field.begin_field(BLANK.field, R, seen, ZERO_VEC3, north, P, x := np.zeros(SIZE))
    assert x[EARTH : EARTH + 3] == pytest.approx((0.16, 0.12, 0.42) if is_known else seen)
    towards = np.outer((0.8, 0.6, 0.0), (0.8, 0.6, 0.0)) + np.diag((0.0, 0.0, 1.0))
    A = (towards if is_known else np.eye(3)) @ R
    others = [i for i in range(SIZE) if not EARTH <= i < EARTH + 3]
    turned = np.cross(np.eye(3), seen).T * (not is_known)
    error = turned @ turn - A @ iron
    assert np.allclose(P[EARTH : EARTH + 3, others], error[:, others])
    assert np.allclose(P, P.T)
    assert np.linalg.eigvalsh(P).min() > -1e-12  # was -0.02 and made sigma no number
    noise = P[EARTH : EARTH + 3, EARTH : EARTH + 3]
    both = error @ to_compass.T @ turned.T - error[:, HARD_IRON : HARD_IRON + 3] @ A.T
    noise = noise - both
    distortion, declination = 0.2 * np.linalg.norm(seen), 0.009 * 0.2
    sigmas = np.sqrt(np.linalg.eigvalsh(noise))
    assert sigmas == pytest.approx(
        (declination if is_known else distortion, distortion, distortion)
    )


@pytest.mark.parametrize(
    ("place", "iron_gauss", "forgets"),
    [
        ((0.2, 0.0, 0.42), ZERO_VEC3, True),  # it was learnt beside a fault that is over
        ((0.2, 0.0, 0.42), (0.08, -0.05, 0.1), False),  # it is the vehicle's own
        (ZERO_VEC3, ZERO_VEC3, False),  # nobody knows the place
    ],
)
def test_iron_is_forgotten_once_the_places_field_explains_the_readings(place, iron_gauss, forgets):
    north, seen = North(True, (1.0, 0.0)), (0.2, 0.0, 0.42)
    now = prediction((1.0, 0.0, 0.0, 0.0))
    estimate = now.estimate._replace(
        earth_gauss=seen, hard_iron_gauss=(0.08, -0.05, 0.1), gyr_bias_rad_s=ZERO_VEC3
    )
    now = now._replace(estimate=estimate, covariance=1e-6 * np.eye(SIZE))
    mag = tuple(a + b for a, b in zip(seen, iron_gauss, strict=True))
    sample = Sample(ZERO_VEC3, ZERO_VEC3, mag, True, 0.1)
    others = BESIDE._replace(north=north, place_gauss=place)
    known = BLANK.field._replace(
        look=FieldLook(horizontal=0.2, down=0.42, confidence=1.0), samples=99.0
    )
    steps = 0
    while known.samples > 1.0 and steps < 50:
        x = np.zeros(SIZE)
        known = field.observe_heading(PARAMS, known._replace(wait_s=0.1), now, others, sample, x)
        steps += 1
    assert (steps < 50) == forgets
    if forgets:
        assert 3 <= steps <= 5  # measured 4
        assert x[HARD_IRON : HARD_IRON + 3] == pytest.approx((-0.08, 0.05, -0.1))
        assert x[EARTH : EARTH + 3] == pytest.approx(ZERO_VEC3)
        assert now.covariance[HARD_IRON, HARD_IRON] == PARAMS.hard_iron_sigma_gauss**2
