"""Each scalar measurement's row against finite differences of what it measures."""

import numpy as np
import pytest

from estimator.aiding.beginning import blank_aiding
from estimator.aiding.covariance import rotation_matrix
from estimator.aiding.inertial import Prediction
from estimator.aiding.sources import field, unaided
from estimator.aiding.types import (
    COMPASS_TURN,
    EARTH,
    FIELD_LAG,
    HARD_IRON,
    SIZE,
    TURN,
    AidingParams,
    North,
    StepInputs,
)
from estimator.aiding.velocity_history import new_velocity_history
from estimator.conditioning.field.magnetic import FieldLook
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import exp, multiply, normalize, rotate, rotate_inverse
from estimator.types import ZERO_VEC3, Sample
from tests.estimator.aiding import heading_source
from tests.estimator.aiding.dense_filter import floats
from tests.estimator.aiding.heading_source import HeadingSample

PARAMS = AidingParams()
BLANK, _, TRAIL = blank_aiding(PARAMS)
STEP = 1e-5
NORTH = (np.cos(0.3), np.sin(0.3))
KNOWN_NORTH = North(is_known=True, direction=NORTH)
BESIDE = StepInputs((0.0, 0.0, 1.0), 0.1, 0.0, KNOWN_NORTH)
LAG_S = 0.09
COMPASS_RAD = 0.4
ACROSS, ALONG, DOWN, DECLINATION = range(4)


@pytest.fixture
def learnt(monkeypatch):
    """The rows and innovations that a measurement learns from, in place of the learning."""
    rows = []

    def kept(_P, _x, h, off, _noise):
        rows.append((h.copy(), off))

    monkeypatch.setattr(field, "learn", kept)
    monkeypatch.setattr(unaided, "learn", kept)
    monkeypatch.setattr(heading_source, "learn", kept)
    return rows


def rows_and_slopes(learnt, observe, errors):
    """The rows, and for each error how fast each innovation falls with it."""
    observe(np.zeros(SIZE))
    rows = np.array([h for h, _ in learnt])
    slopes = np.zeros_like(rows)
    for i in errors:
        change = np.zeros(SIZE)
        change[i] = STEP
        for sign in (1.0, -1.0):
            learnt.clear()
            observe(sign * change)
            slopes[:, i] -= sign * np.array([off for _, off in learnt]) / (2.0 * STEP)
    return rows, slopes


def field_observation(rng, learnt, variance=1e-6, turned_rad=0.0):
    """A reading that fits the state but for an unfelt turn, of a vehicle that turns fast."""
    q = normalize(floats(rng.standard_normal(4)))
    place = np.array([0.2 * NORTH[0], 0.2 * NORTH[1], 0.42])
    iron, rate = 0.1 * rng.standard_normal(3), 3.0 * rng.standard_normal(3)
    q_then = multiply(q, exp(floats(-LAG_S * rate)))
    seen = rotate(exp((0.0, 0.0, turned_rad)), floats(place))
    q_compass = multiply(q_then, exp((0.0, 0.0, -COMPASS_RAD)))
    reading = floats(np.array(rotate_inverse(q_compass, seen)) + iron)

    def observe(change):
        learnt.clear()
        estimate = BLANK.estimate._replace(
            hard_iron_gauss=floats(iron + change[HARD_IRON : HARD_IRON + 3]),
            earth_gauss=floats(place + change[EARTH : EARTH + 3]),
            field_lag_s=LAG_S + change[FIELD_LAG],
            compass_turn_rad=COMPASS_RAD + change[COMPASS_TURN],
            q_ned_frd=multiply(exp(floats(change[TURN : TURN + 3])), q),
        )
        now = Prediction(estimate, ZERO_VEC3, ZERO_VEC3, TRAIL, np.eye(SIZE) * variance)
        look = FieldLook(horizontal=0.2, down=0.42, confidence=1.0)
        known = BLANK.field._replace(look=look, samples=10.0, wait_s=0.1)
        sample = Sample(floats(rate), ZERO_VEC3, reading, True, 0.02)
        field.observe_heading(PARAMS, known, now, BESIDE, sample, np.zeros(SIZE))

    return observe


FIELD_ERRORS = (*range(TURN, TURN + 3), FIELD_LAG, COMPASS_TURN, *range(HARD_IRON, EARTH + 3))


@pytest.mark.parametrize("seed", range(5))
def test_field(learnt, seed):
    observe = field_observation(np.random.default_rng(seed), learnt)
    rows, slopes = rows_and_slopes(learnt, observe, FIELD_ERRORS)
    assert len(rows) == 4
    assert rows == pytest.approx(slopes, abs=1e-7)  # measured 5e-8


@pytest.mark.parametrize("turned_rad", [1.5, -2.5])
def test_field_seen_from_an_unknown_heading(learnt, turned_rad):
    """A heading known to a radian: the field gives it as an angle."""
    rng = np.random.default_rng(8)
    observe = field_observation(rng, learnt, variance=1.0, turned_rad=turned_rad)
    rows, slopes = rows_and_slopes(learnt, observe, FIELD_ERRORS)
    assert rows[ACROSS] == pytest.approx(slopes[ACROSS], abs=1e-7)  # measured 5e-8
    # along the place's field and down a tilt only makes the reading less certain
    assert not np.any(rows[ALONG : DOWN + 1, TURN : TURN + 3])


def test_declination_of_a_field_learnt_the_wrong_way_round():
    """The place's field may be learnt to point south while iron is: no saddle holds it there."""
    P, x = np.eye(SIZE), np.zeros(SIZE)
    field.learn_declination(P, x, (-0.2, 0.02, 0.42), (1.0, 0.0), 1.0)
    assert abs(x[EARTH + 1]) == pytest.approx(0.61, rel=0.2)


def prediction(q_ned_frd):
    """At rest with that attitude, of which nothing is known."""
    estimate = BLANK.estimate._replace(q_ned_frd=q_ned_frd)
    return Prediction(estimate, ZERO_VEC3, ZERO_VEC3, new_velocity_history(ZERO_VEC3), np.eye(SIZE))


@pytest.mark.parametrize("seed", range(5))
def test_a_heading_from_outside(learnt, seed):
    """The vehicle is nearly level, so that only a turn about down changes its heading."""
    rng = np.random.default_rng(seed)
    q = from_euler_rad(*floats(rng.uniform((-0.01, -0.01, -3.0), (0.01, 0.01, 3.0))))
    report = HeadingSample(0, float(rng.uniform(0.0, 6.0)), 0.1)

    def observe(change):
        learnt.clear()
        turned = multiply(exp(floats(change[TURN : TURN + 3])), q)
        heading_source.observe_heading(PARAMS, prediction(turned), report, 0.0, np.zeros(SIZE))

    rows, slopes = rows_and_slopes(learnt, observe, range(TURN, TURN + 3))
    assert rows == pytest.approx(slopes, abs=0.01)  # what the row leaves out: the tilt
    assert rows[0, TURN + 2] == pytest.approx(slopes[0, TURN + 2], abs=1e-4)


@pytest.mark.parametrize(
    ("sigma_rad", "tilt_error_rad", "lasts_s"), [(0.1, 0.0, 1.0), (0.0, 0.2, 3.0)]
)
def test_unaided_gravity_counts_as_one_measurement_in_its_correlation_time(
    monkeypatch, sigma_rad, tilt_error_rad, lasts_s
):
    """An acceleration lasts 3 s: samples within that together weigh as much as one."""
    noises = []
    monkeypatch.setattr(unaided, "learn", lambda *arguments: noises.append(arguments[-1]))
    now = prediction((1.0, 0.0, 0.0, 0.0))
    for dt in (0.02, 0.25):
        noises.clear()
        down = (0.0, 0.0, 1.0)
        unaided.observe_unaided(now, down, sigma_rad, tilt_error_rad, np.zeros(SIZE), 1.0, dt)
        weight = lasts_s / dt / noises[0]
        assert weight == pytest.approx(1.0 / (sigma_rad**2 + tilt_error_rad**2))


@pytest.mark.parametrize("is_known", [True, False])
def test_the_places_field_begins_towards_north_where_that_is_known(learnt, is_known):
    """Known, it points there and its direction is sure; unknown, it points as it is seen."""
    north = North(is_known, (1.0, 0.0))
    P, x, seen = np.eye(SIZE) * 1e-4, np.zeros(SIZE), (0.12, 0.16, 0.42)
    known = field.begin_field(BLANK.field, np.eye(3), seen, ZERO_VEC3, north, P, x)
    expected = (0.2, 0.0, 0.42) if is_known else seen
    assert x[EARTH : EARTH + 3] == pytest.approx(expected)
    across = np.array((-x[EARTH + 1], x[EARTH])) / 0.2
    sigma = np.sqrt(across @ P[EARTH : EARTH + 2, EARTH : EARTH + 2] @ across)
    # half a degree of declination, or a fifth of the field, the hard iron, heading and compass
    unsure = np.sqrt(0.04 * np.dot(seen, seen) + 0.01**2 * (1.0 + 0.42**2 + 2.0 * 0.2**2))
    assert sigma == pytest.approx(0.2 * 0.009 if is_known else unsure)
    learnt.clear()
    look = FieldLook(horizontal=0.2, down=0.42, confidence=1.0)
    now = prediction((1.0, 0.0, 0.0, 0.0))
    now = now._replace(estimate=now.estimate._replace(earth_gauss=expected))
    sample = Sample(ZERO_VEC3, ZERO_VEC3, seen, True, 0.02)
    known = known._replace(look=look, wait_s=0.1)
    others = BESIDE._replace(north=north)
    field.observe_heading(PARAMS, known, now, others, sample, np.zeros(SIZE))
    assert len(learnt) == (4 if is_known else 3)  # the declination is the fourth


@pytest.mark.parametrize("is_known", [True, False])
def test_a_field_begun_anew_hangs_together_with_all_that_is_known_of_the_iron(is_known):
    """The iron's errors differ by axis then, and are correlated with other states.

    If north is unknown, the field points by heading and compass: a turn is an error of both.
    """
    rng = np.random.default_rng(2)
    root = rng.normal(scale=0.1, size=(SIZE, SIZE))
    P, R = root @ root.T, rotation_matrix(normalize(tuple(rng.normal(size=4))))
    iron, to_compass = P[HARD_IRON : HARD_IRON + 3].copy(), np.eye(SIZE)[TURN : TURN + 3]
    to_compass[:, COMPASS_TURN] = -R[:, 2]  # a turned compass sees the vehicle turned the other way
    turn = to_compass @ P
    seen, north = (0.12, 0.16, 0.42), North(is_known, (0.8, 0.6))
    field.begin_field(BLANK.field, R, seen, ZERO_VEC3, north, P, np.zeros(SIZE))
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
    """139 mGauss of iron are gone: the field begins anew within half a second."""
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
