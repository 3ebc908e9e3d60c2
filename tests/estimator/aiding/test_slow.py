"""The aided stage at a ground station's rate: what samples hide, and what tilts the vertical."""

from math import degrees

import numpy as np
import pytest

from estimator.aiding.acceleration_tilt import (
    acceleration_tilt_angle,
    explains_acceleration,
    watch_acceleration_tilt,
    with_latest,
)
from estimator.aiding.types import SIZE, TURN, VELOCITY, AccelerationTilt, AidingParams, Roughness
from estimator.aiding.unseen import add_hole, add_unseen_turn, watch_roughness
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3


def unseen_turn_deg(readings, dt_s):
    """Sigma (deg) of the turn that the last step has missed, after readings about one axis."""
    rough = Roughness(0.0, 0.0, 0.0)
    P = np.zeros((SIZE, SIZE))
    for first, second, third in zip(readings, readings[1:], readings[2:], strict=False):
        second_difference = ((third - second) - (second - first), 0.0, 0.0)
        P[:] = 0.0
        add_unseen_turn(AidingParams(), P, rough, second_difference, dt_s, dt_s)
        rough = watch_roughness(rough, second_difference, (third - second, 0.0, 0.0), dt_s)
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
    add_hole(P, 0.9)
    assert not P.any()
    add_hole(P, 3.0)
    assert degrees(np.sqrt(P[TURN, TURN])) == pytest.approx(34.4, rel=0.01)
    assert np.sqrt(P[VELOCITY, VELOCITY]) == pytest.approx(0.6 * 9.80665)


def pushed(felt, reported):
    """A vehicle that has felt the one and reported the other for 10 s, m/s^2 to the north."""
    tilt = AccelerationTilt(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
    for k in range(40):
        tilt = watch_acceleration_tilt(tilt, (felt, 0.0, -STANDARD_GRAVITY_M_S2), 0.25)
        tilt = with_latest(tilt, (reported * 0.25 * k, 0.0, 0.0))
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
    found = degrees(acceleration_tilt_angle(pushed(felt, reported), is_silent, 0.0))
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
    assert explains_acceleration(pushed(felt, reported)) == explains
