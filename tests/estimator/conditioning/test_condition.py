"""The whole stage, on motions whose truth is known."""

from math import cos, pi, radians, sin

import pytest

from estimator.conditioning.condition import Conditioned, condition
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.state import initial_state
from estimator.geometry.quaternion import exp, multiply, normalize, rotate_inverse
from estimator.types import Sample
from tests.estimator.conditioning.motion import vector_errors_rad

GRAVITY = (0.0, 0.0, 9.81)
FIELD = (0.2, 0.0, 0.42)


def observe(q, scale=1.0):
    """Specific force and field of a vehicle at rest with attitude ``q``."""
    acc = rotate_inverse(q, (0.0, 0.0, -GRAVITY[2]))
    mag = rotate_inverse(q, FIELD)
    return acc, tuple(scale * m for m in mag)


def run(q, seconds, dt, *, gyr=(0.0, 0.0, 0.0), mag_scale=1.0, state=None, params=None, mag=True):
    """A vehicle that rests at ``q`` with a biased gyro; the last result and state."""
    params = params or ConditioningParams()
    state = state or initial_state(params)
    acc, field = observe(q, mag_scale)
    for _ in range(round(seconds / dt)):
        state, out = condition(params, state, Sample(gyr, acc, field, mag, dt))
    return state, out


def assert_vectors_close(out: Conditioned, q, max_angle_rad):
    assert max(vector_errors_rad(out, q)) < max_angle_rad


ATTITUDES = [
    (1.0, 0.0, 0.0, 0.0),
    (cos(pi / 4), sin(pi / 4), 0.0, 0.0),  # on its side
    (0.0, 1.0, 0.0, 0.0),  # on its back
    normalize((0.3, -0.5, 0.7, 0.2)),
]


@pytest.mark.parametrize("q", ATTITUDES)
@pytest.mark.parametrize("dt", [0.0025, 0.02, 0.25, 1.0])
@pytest.mark.parametrize("mag_scale", [1.0, 50.0, 430.0])
def test_rest_gives_the_true_vectors_at_any_rate_and_field_unit(q, dt, mag_scale):
    _, out = run(q, 8.0, dt, mag_scale=mag_scale)
    assert_vectors_close(out, q, 1.2e-6)  # measured 1.04e-6
    assert out.magnetic_confidence == pytest.approx(1.0)


@pytest.mark.parametrize("dt", [0.0035, 0.02, 0.25])
def test_bias_is_learnt_at_rest(dt):
    bias = (radians(0.4), radians(-0.3), radians(0.2))
    state, out = run(ATTITUDES[3], 40.0, dt, gyr=bias)
    # measured 0.00012 deg/s; with noise 0.03 deg/s is the steady sigma at rest
    assert out.bias_rad_s == pytest.approx(bias, abs=radians(0.00015))
    assert state.vertical.rest.resting


def test_without_a_field_there_is_gravity_and_no_heading():
    _, out = run(ATTITUDES[3], 5.0, 0.02, mag=False)
    assert not out.has_heading
    assert out.sigma_heading_rad == float("inf")
    assert vector_errors_rad(out, ATTITUDES[3])[0] < 1e-6


def test_a_gap_of_minutes_leaves_finite_values():
    params = ConditioningParams()
    state, _ = run(ATTITUDES[0], 10.0, 0.02)
    acc, mag = observe(ATTITUDES[1])
    state, _ = condition(params, state, Sample((0.1, 0.2, 0.3), acc, mag, True, 120.0))
    _, out = run(ATTITUDES[1], 20.0, 0.02, state=state)
    assert_vectors_close(out, ATTITUDES[1], radians(0.04))  # measured 0.033


def test_turning_vehicle_keeps_its_vectors():
    """A steady turn about down, from the first sample: no rest to learn from."""
    params = ConditioningParams()
    state = initial_state(params)
    q = ATTITUDES[3]
    dt = 0.01
    rate_ned = (0.0, 0.0, 0.5)
    for _ in range(4000):
        gyr = rotate_inverse(q, rate_ned)
        q = normalize(multiply(q, exp(tuple(dt * w for w in gyr))))
        acc, mag = observe(q)
        state, out = condition(params, state, Sample(gyr, acc, mag, True, dt))
    assert_vectors_close(out, q, 1e-7)  # measured 3e-8
    assert not state.vertical.rest.resting
