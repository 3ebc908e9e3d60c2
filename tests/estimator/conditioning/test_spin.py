"""A gyroscope's scale error in a turn that goes on."""

from math import cos, degrees, pi, radians, sin

import pytest

from estimator.conditioning import ConditioningParams, condition, initial_state
from estimator.geometry.quaternion import angle_between_vectors, rotate_inverse
from estimator.types import Sample
from tests.estimator.conditioning.motion import fly

PARAMS = ConditioningParams()
DT = 0.01
DOWN = (0.0, 0.0, 1.0)


def rolling(t):
    """At rest for 15 s; then half a revolution a second about an axis, a little about others."""
    if t < 15.0:
        return (0.0, 0.0, 0.0)
    return (radians(180.0) + 0.1 * sin(t), 0.3 * sin(2.0 * t), 0.3 * cos(1.5 * t))


def run(rate, error, params=PARAMS, seconds=80.0):
    """The state at the end, and the mean angle (deg) of the vertical's last half minute.

    A gyroscope whose first axis reads a share of ``error`` too much.
    """
    state, angles = initial_state(params), []
    for s in fly(rate, seconds, DT):
        gyr = (s.gyr[0] * (1.0 + error), s.gyr[1], s.gyr[2])
        state, out = condition(params, state, Sample(gyr, s.acc, s.mag, True, DT))
        down = rotate_inverse(s.q_ned_frd, DOWN)
        angles.append(degrees(angle_between_vectors(out.gravity_b, down)))
    late = angles[len(angles) // 2 :]
    return state, sum(late) / len(late)


def test_a_steady_turn_shows_the_scale_error():
    state, _ = run(rolling, 0.004)
    assert state.vertical.spin.scale_error == pytest.approx(0.004, rel=0.2)


def test_a_vertical_that_is_learnt_so_leans_less():
    """0.4 % of 180 deg/s, 2 s behind, are 1.4 deg; a force that tells so is averaged for less."""
    usual = PARAMS._replace(use_averaging=False)
    _, with_it = run(rolling, 0.004, usual)
    _, without = run(rolling, 0.004, usual._replace(use_scale_error=False))
    _, averaged = run(rolling, 0.004, PARAMS._replace(use_scale_error=False))
    assert without == pytest.approx(1.4, rel=0.2)
    assert with_it == pytest.approx(0.236, rel=0.2)
    assert averaged == pytest.approx(0.152, rel=0.2)


def test_a_shaken_vehicle_with_a_good_gyroscope_learns_next_to_none():
    """Accelerations of 3 m/s^2 at 0.7 Hz; the turn is the same."""
    state = initial_state(PARAMS)
    for i, s in enumerate(fly(rolling, 80.0, DT)):
        push = (3.0 * sin(1.4 * pi * DT * i), 3.0 * cos(1.4 * pi * DT * i), 0.0)
        acc = tuple(a + b for a, b in zip(s.acc, rotate_inverse(s.q_ned_frd, push), strict=True))
        state, _ = condition(PARAMS, state, Sample(s.gyr, acc, s.mag, True, DT))
    assert abs(state.vertical.spin.scale_error) < 0.0004  # measured 0.00033
