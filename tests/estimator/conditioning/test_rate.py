"""Turns over one step against rotations worked out in small pieces."""

import numpy as np
import pytest

from estimator.conditioning.vertical.rate import at_interval_end
from estimator.geometry.quaternion import angle_between, exp, multiply, rotate_inverse, scale

RATE = (1.5, -2.0, 0.7)  # rad/s


@pytest.mark.parametrize("dt", [0.01, 0.05])
def test_a_mean_over_the_step_is_turned_to_its_end(dt):
    """A direction fixed in the world, seen from a body that turns steadily, averaged over the step.

    What is left is of second order in the turn: under its square; turned the wrong way it would be
    the turn itself.
    """
    fixed = (0.3, 0.8, -0.5)
    times = (np.arange(1000) + 0.5) / 1000 * dt
    seen = np.array([rotate_inverse(exp(scale(t, RATE)), fixed) for t in times])
    mean = tuple(seen.mean(axis=0).tolist())
    at_end = rotate_inverse(exp(scale(dt, RATE)), fixed)
    turn = dt * np.linalg.norm(RATE)
    off = np.linalg.norm(np.subtract(at_interval_end(mean, RATE, dt), at_end))
    assert off == pytest.approx(0.067 * turn**2, rel=0.2)
    assert np.linalg.norm(np.subtract(mean, at_end)) == pytest.approx(0.40 * turn, rel=0.2)


def test_integration_of_a_turning_axis_has_the_cones_sign():
    """Half a second of two rates, the axis moving from x to y: the exact turn by small pieces."""
    from estimator.conditioning.vertical.rate import integration_rate

    before, after, dt = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.5
    q, pieces = (1.0, 0.0, 0.0, 0.0), 2000
    for k in range(pieces):
        share = (k + 0.5) / pieces
        rate = tuple((1 - share) * b + share * a for b, a in zip(before, after, strict=True))
        q = multiply(q, exp(scale(dt / pieces, rate)))
    ours = exp(scale(dt, integration_rate(before, after, dt, False)))
    # without the cone 0.021 rad, with the wrong sign 0.042
    assert angle_between(ours, q) == pytest.approx(0.00074, rel=0.2)
