"""What the unaided gravity and the field count for, and what a ground station's rate hides."""

from math import degrees

import numpy as np
import pytest

from estimator.aiding import acceleration_tilt as tilts
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
    VELOCITY,
    AccelerationTilt,
    AidingParams,
    North,
    Roughness,
    StepInputs,
)
from estimator.aiding.unseen import watch_turning
from estimator.aiding.velocity_history import new_velocity_history
from estimator.conditioning.field.magnetic import FieldLook
from estimator.geometry.quaternion import normalize
from estimator.types import NO_SAMPLE, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Sample

PARAMS = AidingParams()
BLANK, _, _ = blank_aiding(PARAMS)


def test_declination_of_a_field_learnt_the_wrong_way_round():
    """The place's field may be learnt to point south while iron is: no saddle holds it there."""
    P, x = np.eye(SIZE), np.zeros(SIZE)
    field.learn_declination(P, x, (-0.2, 0.02, 0.42), (1.0, 0.0), 1.0)
    assert abs(x[EARTH + 1]) == pytest.approx(0.61, rel=0.2)


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
    estimate = BLANK.estimate._replace(earth_gauss=seen, hard_iron_gauss=(0.08, -0.05, 0.1))
    history, P = new_velocity_history(ZERO_VEC3), 1e-6 * np.eye(SIZE)
    now = Prediction(estimate, ZERO_VEC3, ZERO_VEC3, history, P)
    mag = tuple(a + b for a, b in zip(seen, iron_gauss, strict=True))
    sample = Sample(ZERO_VEC3, ZERO_VEC3, mag, True, 0.1)
    others = StepInputs((0.0, 0.0, 1.0), 0.1, 0.0, north)._replace(place_gauss=place)
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


def unseen_turn_deg(readings, dt_s):
    """Sigma (deg) of the turn that the last step has missed, after readings about one axis."""
    rough = Roughness(0.0, 0.0, 0.0)
    P = np.zeros((SIZE, SIZE))
    for first, second, third in zip(readings, readings[1:], readings[2:], strict=False):
        last = BLANK.last._replace(
            gyr_rad_s=(second, 0.0, 0.0), gyr_before_rad_s=(first, 0.0, 0.0), dt_s=dt_s
        )
        sample = NO_SAMPLE._replace(gyr_rad_s=(third, 0.0, 0.0), dt_s=dt_s)
        P[:] = 0.0
        rough = watch_turning(PARAMS, last, rough, P, sample, 0.0)
    return degrees(np.sqrt(P[TURN, TURN] + P[TURN + 1, TURN + 1] + P[TURN + 2, TURN + 2]))


SHAKEN = (0.5 * np.random.default_rng(1).standard_normal(60)).tolist()


@pytest.mark.parametrize(
    ("readings", "dt_s", "turn_deg"),
    [
        # independent ones: the mean of two is off their mean by 0.35 rad/s, 8.1 deg in 0.4 s
        (SHAKEN, 0.4, 6.1),
        ((0.7 * np.sin(np.arange(60) * 0.6)).tolist(), 0.4, 0.03),  # a swing that they show
        (SHAKEN, 0.02, 0.0),  # a fast stream hides nothing more
    ],
)
def test_what_aliased_readings_hide_is_reckoned_with(readings, dt_s, turn_deg):
    assert unseen_turn_deg(readings, dt_s) == pytest.approx(turn_deg, rel=0.2, abs=0.0)


def test_a_hole_may_hide_any_turn():
    P = np.zeros((SIZE, SIZE))
    watch_turning(PARAMS, BLANK.last, BLANK.rough, P, NO_SAMPLE._replace(dt_s=0.9), 0.0)
    assert not P.any()
    watch_turning(PARAMS, BLANK.last, BLANK.rough, P, NO_SAMPLE._replace(dt_s=3.0), 0.0)
    assert degrees(np.sqrt(P[TURN, TURN])) == pytest.approx(34.4, rel=0.01)
    assert np.sqrt(P[VELOCITY, VELOCITY]) == pytest.approx(0.6 * 9.80665)


def pushed(felt, reported):
    """A vehicle that has felt the one and reported the other for 10 s, m/s^2 to the north."""
    tilt = AccelerationTilt(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
    for k in range(40):
        tilt = tilts.watch_acceleration_tilt(tilt, (felt, 0.0, -STANDARD_GRAVITY_M_S2), 0.25)
        tilt = tilt._replace(latest_m_s=(reported * 0.25 * k, 0.0, 0.0))
    return tilt


@pytest.mark.parametrize(
    ("felt", "reported", "is_silent", "tilt_deg"),
    [
        (5.0, 5.0, False, 28.0),  # 5 m/s^2 of 9.8: 29 deg
        (5.0, 0.0, False, 0.0),  # a wrong attitude
        (0.0, 5.0, False, 0.0),  # a wrong receiver
        (5.0, 0.0, True, 28.0),
    ],
)
def test_only_an_acceleration_that_is_felt_and_reported_tilts_the_unaided_vertical(
    felt, reported, is_silent, tilt_deg
):
    found = degrees(tilts.acceleration_tilt_angle(pushed(felt, reported), is_silent, 0.0))
    assert found == pytest.approx(tilt_deg, rel=0.1)


@pytest.mark.parametrize(
    ("felt", "reported", "explains"),
    [
        (5.0, 5.0, True),
        (3.0, 5.0, True),
        (2.0, 5.0, False),  # explains too little of it
        (-5.0, 5.0, False),  # has it the wrong way round
        (0.5, 0.5, False),  # too little to decide
        (float("nan"), 5.0, False),
    ],
)
def test_an_attitude_explains_a_clear_acceleration_that_it_has_felt(felt, reported, explains):
    assert tilts.explains_acceleration(pushed(felt, reported)) == explains
