"""The low-pass against the differential equation it solves."""

from math import pi

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimator.conditioning.vertical.lowpass import low_pass, smooth_scalar


@pytest.mark.parametrize("dt", [0.0025, 0.1, 0.7])
def test_step_is_the_solution_of_the_differential_equation(dt):
    tau, u = 0.5, 1.0
    y, w = 0.3, -0.2
    solution = solve_ivp(
        lambda _t, x: [x[1] / tau, (2.0 * (u - x[0]) - 2.0 * x[1]) / tau],
        (0.0, dt),
        [y, w],
        rtol=1e-10,
        atol=1e-12,
    )
    value, slope = smooth_scalar(low_pass(tau, dt), y, tau * w, u)
    assert (value, slope / tau) == pytest.approx(solution.y[:, -1], abs=1e-8)


@pytest.mark.parametrize("dt", [0.0025, 1.0, 60.0, 1e6])
def test_any_time_step_ends_at_the_input(dt):
    k = low_pass(3.0, dt)
    y, w = 100.0, -50.0
    for _ in range(max(1, round(60.0 / dt))):
        y, w = smooth_scalar(k, y, w, 1.0)
    assert y == pytest.approx(1.0, abs=1e-5)


def test_another_time_constant_leaves_no_swing_behind():
    """Shaken to and fro about 1 at 1 Hz: from 2.5 s to 4 s at any phase."""
    dt, before, after = 0.01, low_pass(2.5, 0.01), low_pass(4.0, 0.01)
    worst = 0.0
    for phase in range(0, 100, 5):
        y, w = 1.0, 0.0
        for i in range(3000 + phase):
            y, w = smooth_scalar(before, y, w, 1.0 + np.sin(2.0 * pi * i * dt))
        for i in range(3000 + phase, 3000 + phase + 1500):
            y, w = smooth_scalar(after, y, w, 1.0 + np.sin(2.0 * pi * i * dt))
            worst = max(worst, abs(y - 1.0))
    assert worst == pytest.approx(0.008, rel=0.2)
