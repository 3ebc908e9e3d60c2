"""The turn that a saturated gyroscope misses, and vectors turned to the end of a step."""

from math import pi, sin

import numpy as np
import pytest

from estimator.conditioning.vertical.averaging import MOST_ERROR
from estimator.conditioning.vertical.rate import (
    Clipping,
    aliased_turn,
    at_interval_end,
    watch_axis,
    watch_clipping,
)
from estimator.geometry.quaternion import exp, rotate_inverse, scale
from estimator.types import ZERO_VEC3


def test_the_missed_turn_grows_with_the_square_of_the_run():
    """It is (beyond T)^2 after T seconds, whatever the lengths of the steps."""
    peak, run_s, aliasing, lasts_s = 5.5, 0.0, 0.0, 0.0
    for dt_s in (0.01, 0.03, 0.02, 0.05):
        peak, run_s, aliasing = watch_axis(peak, run_s, aliasing, -5.5, -5.5, dt_s)
        lasts_s += dt_s
        assert run_s == pytest.approx(lasts_s)
        assert aliasing == pytest.approx((MOST_ERROR * 5.5 * lasts_s) ** 2)
    assert watch_axis(peak, run_s, aliasing, -5.5, -5.4, 0.01) == (5.5, 0.0, aliasing)


def test_each_axis_has_its_own_peak_run_and_variance():
    before = Clipping((3.0, 4.0, 5.0), (0.1, 0.2, 0.3), (0.01, 0.02, 0.03))
    previous, now = (3.0, -4.0, 5.0), (3.0, -4.0, 4.9)
    after = watch_clipping(before, previous, now, 0.02)
    axes = [
        watch_axis(*axis, 0.02)
        for axis in zip(
            before.peak_rad_s, before.run_s, before.aliasing, previous, now, strict=True
        )
    ]
    assert after == Clipping(*zip(*axes, strict=True))
    assert after.run_s == pytest.approx((0.12, 0.22, 0.0))


def test_what_is_missed_about_down_is_not_missed_about_level_axes():
    state = Clipping(aliasing=(0.01, 0.04, 0.09))
    level, about = aliased_turn(state, (0.48, -0.6, 0.64))
    assert about == pytest.approx(0.01 * 0.48**2 + 0.04 * 0.6**2 + 0.09 * 0.64**2)
    assert level == pytest.approx(0.14 - about)


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


def test_only_a_reading_that_stands_still_at_its_largest_is_at_the_end():
    state, before = Clipping(), ZERO_VEC3
    for k in range(60):
        gyr = (5.0 * sin(pi * 0.01 * k), 0.0, 0.0)
        state, before = watch_clipping(state, before, gyr, 0.01), gyr
    assert state.peak_rad_s[0] == pytest.approx(5.0)
    assert aliased_turn(state, (0.0, 0.0, 1.0)) == (0.0, 0.0)
