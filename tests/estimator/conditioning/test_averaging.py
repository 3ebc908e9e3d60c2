"""Low-passes, for how long the force is averaged, and what is known of its mean."""

from math import degrees, expm1, pi, radians, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimator.conditioning.state import initial_state
from estimator.conditioning.vertical.averaging import (
    WINDOW_S,
    Averaging,
    averaging_at_rest,
    follow_averaging,
)
from estimator.conditioning.vertical.gravity import observe_gravity
from estimator.conditioning.vertical.lowpass import coefficients, low_pass
from tests.estimator.conditioning.motion import PARAMS, smooth_scalar

G, DT = 9.8, 0.05
KNOWN_BIAS = radians(0.01) ** 2


def averaging(tilt_error_rad, rate_rad_s, *, params=PARAMS, bias=KNOWN_BIAS, time_s=120.0):
    """After a force that tilts by an angle about north, and a turn about it, functions of time."""
    state = Averaging()
    for i in range(round(time_s / DT)):
        angle, rate = tilt_error_rad(i * DT), rate_rad_s(i * DT)
        force = (0.0, -G * np.sin(angle), G * np.cos(angle))
        state = follow_averaging(params, state, force, (rate, 0.0, 0.0), bias, DT)
    return state


def shaken(tilt_deg, period_s):
    return lambda t: radians(tilt_deg) * np.sin(2 * np.pi * t / period_s)


def nothing(t):
    return 0.0


def tau_s(state):
    return state.factor * PARAMS.gravity_tau_s


def sigma_deg(state):
    return degrees(sqrt(state.variance))


def drifting(share, rate_rad_s):
    """A gyroscope that errs by a share of its turn to and fro, 20 s each way."""

    def turning(t):
        return rate_rad_s * np.sign(np.sin(np.pi * t / 20.0))

    def tilting(t):
        return share * rate_rad_s * abs((t + 20.0) % 40.0 - 20.0)

    return tilting, turning


@pytest.mark.parametrize(
    ("tilting", "turning", "tau", "sigma"),
    [
        *((shaken(10.0, s), nothing, *x) for s, *x in ((0.5, 1.67, 0.109), (2.0, 3.84, 0.191))),
        (shaken(10.0, 20.0), nothing, 11.4, 2.62),
        (*drifting(0.003, 1.0), 0.65, 0.313),
        (*drifting(0.06, 1.0), 0.25, 0.704),
    ],
)
def test_accelerations_are_averaged_for_longer_than_they_last(tilting, turning, tau, sigma):
    """Not where a gyroscope drifts as it turns."""
    state = averaging(tilting, turning)
    assert tau_s(state) == pytest.approx(tau, rel=0.2)
    assert sigma_deg(state) == pytest.approx(sigma, rel=0.2)


def test_a_drift_without_a_turn_is_an_acceleration():
    """It tilts as that gyroscope makes it, which meanwhile shows no turn."""
    tilting, turning = drifting(0.06, 1.0)
    driven, drifted = averaging(tilting, nothing), averaging(tilting, turning)
    assert tau_s(driven) > 10.0 * tau_s(drifted)  # measured 30
    assert sigma_deg(driven) > 5.0 * sigma_deg(drifted)  # measured 20


def test_an_unknown_bias_may_have_made_it_drift():
    tilting, _ = drifting(0.06, 1.0)
    known = averaging(tilting, nothing)
    unknown = averaging(tilting, nothing, bias=radians(5.0) ** 2)
    assert tau_s(unknown) < 0.2 * tau_s(known)


def test_little_is_known_at_first():
    usual = Averaging()
    state = averaging(shaken(10.0, 20.0), nothing, time_s=0.9 * WINDOW_S)
    assert state.factor == usual.factor
    assert state.variance == usual.variance
    assert all(octave.apart == 0.0 for octave in state.octaves)


def test_at_rest_what_was_left_goes_and_no_more_than_the_usual_time_is_asked_for():
    state = averaging(shaken(10.0, 20.0), nothing)
    for _ in range(round(10.0 / DT)):
        state = averaging_at_rest(PARAMS, state, DT)
    assert state.factor == 1.0
    assert sigma_deg(state) < 0.5


def test_it_may_be_switched_off():
    params = PARAMS._replace(use_averaging=False)
    state = averaging(shaken(10.0, 20.0), nothing, params=params)
    assert (state.factor, state.share) == (1.0, 0.0)


@pytest.mark.parametrize("dt", [0.0025, 0.1, 0.7])
def test_step_is_the_solution_of_the_differential_equation(dt):
    tau, u = 0.5, 1.0
    y, w = 0.3, -0.2

    def slopes(_t, x):
        return [x[1] / tau, (2.0 * (u - x[0]) - 2.0 * x[1]) / tau]

    solution = solve_ivp(slopes, (0.0, dt), [y, w], rtol=1e-10, atol=1e-12)
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


def test_the_long_mean_follows_the_published_vertical_s_force_three_times_as_slowly():
    """A force that steps: the mean of the low-passed one lags by three of its time constants."""
    k = coefficients(PARAMS, 0.01, 1.0)
    gravity = initial_state(PARAMS).vertical.gravity
    for second in range(200):
        u = (0.0, 0.0, G) if second < 60 else (1.2, -0.4, 9.6)
        for _ in range(100):
            before = gravity.force
            gravity = observe_gravity(PARAMS, k, gravity, u, 0.0, 0.0)
        if second == 62:
            share = -expm1(-0.01 / PARAMS.gravity_tau_s) / 3.0
            best, long = np.array(gravity.force.best.value), np.array(before.long)
            assert gravity.force.long == pytest.approx(long + share * (best - long), rel=1e-12)
            assert 0.1 < gravity.force.long[0] < 0.5 * best[0]
    assert gravity.force.long == pytest.approx((1.2, -0.4, 9.6), abs=1e-3)
