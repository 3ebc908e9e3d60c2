"""The gain that knows the noise: its surface, its measures, its descent."""

import numpy as np
import pytest
from hypothesis import given

from drivers.simulation.simulated_vehicle import GYRO_NOISE_RAD_S, VECTOR_NOISE
from estimator.filter import kernel, noise_gain
from estimator.filter.types import FilterState
from estimator.geometry.quaternion import exp, rotate_inverse, unit
from estimator.live.settings import settings_of
from estimator.profile import load_profile
from estimator.types import Sample
from tests.paper_noise import NoiseScale, samples_of, simulate_scaled
from tests.vocabulary import floats

FLOORS = floats(0.0, 40.0)


def run(scale, start=None, seed=11):
    """The states of profile ``adaptive`` over the paper's signals."""
    chosen = settings_of(load_profile("adaptive"))
    states = [FilterState(chosen.initial if start is None else start)]
    for _, gyr, acc, mag, _ in samples_of(simulate_scaled(seed, 400, scale)):
        sample = Sample(gyr, acc, mag, True, 0.01)
        states.append(kernel.step(chosen.filter, chosen.reference, states[-1], sample))
    return states[1:]


@given(FLOORS, FLOORS, FLOORS, floats(noise_gain.RESTING_LEAST, noise_gain.RESTING_MOST))
def test_the_surface_never_descends(error, rate, more, resting):
    K = noise_gain.rules_gain(resting, error, rate)
    assert resting * (1.0 - 1e-12) <= K <= noise_gain.LARGEST_GAIN * (1.0 + 1e-12)
    assert noise_gain.rules_gain(resting, error + more, rate) >= K * (1.0 - 1e-12)
    assert noise_gain.rules_gain(resting, error, rate + more) >= K * (1.0 - 1e-12)


def test_the_surface_has_no_steps():
    """K grows by at most the factor that 2 % of an input make of the table's steepest slope."""
    grid = np.geomspace(1.0, 20.0, 152)
    K = np.array([[noise_gain.rules_gain(2.0, e, d) for e in grid] for d in grid])
    most = (noise_gain.LARGEST_GAIN / 2.0) ** (0.5 * np.log(grid[1] / grid[0]) / np.log(1.15))
    for axis in (0, 1):
        assert np.exp(np.abs(np.diff(np.log(K), axis=axis))).max() <= most * (1.0 + 1e-9)
    assert K.min() == pytest.approx(2.0)
    assert K.max() == pytest.approx(noise_gain.LARGEST_GAIN)


@pytest.mark.parametrize(("gyroscope", "vectors"), [(1.0, 1.0), (5.0, 1.0), (1.0, 5.0), (0.5, 3.0)])
def test_the_noise_is_measured(gyroscope, vectors):
    """The magnetic vector is shortened by its bias, so its noise is larger as an angle."""
    states = [s.noise for s in run(NoiseScale(gyroscope, vectors))[50:]]
    rate = np.sqrt(np.mean([s.rate_variance for s in states]))
    vector = np.sqrt(np.mean([s.vector_variance for s in states]))
    assert rate == pytest.approx(gyroscope * GYRO_NOISE_RAD_S, rel=0.05)
    assert vector == pytest.approx(vectors * VECTOR_NOISE, rel=0.12)


def test_a_wrong_estimate_is_no_noise():
    """Up to the bias, which a wrong start moves by hundredths of a rad/s, times 10 ms."""
    right, wrong = (
        run(NoiseScale(), start)[-1].noise for start in (exp((0.0, 0.0, 0.0)), exp((2.0, 1.0, 0.5)))
    )
    assert wrong.vector_variance == pytest.approx(right.vector_variance, rel=1e-2)
    assert wrong.rate_variance == pytest.approx(right.rate_variance, rel=1e-2)


def test_turning_is_no_noise():
    """Beyond first order half the square of the angle is left."""
    turn = (0.03, -0.04, 0.0)
    before = unit((1.0, 2.0, 3.0))
    now = rotate_inverse(exp(turn), before)
    assert noise_gain.squared_change(before, now, turn) < (0.5 * 0.05**2) ** 2
    assert noise_gain.squared_change(before, now, (0.0, 0.0, 0.0)) > 0.03**2


def test_the_resting_gain_is_a_kalman_filters_share():
    noise = noise_gain.NO_NOISE._replace(samples=9.0, rate_variance=0.2**2, vector_variance=0.05**2)
    expected = noise_gain.RESTING_SHARE * 0.2 / 0.05
    assert noise_gain.resting_gain(noise, 60.0) == pytest.approx(expected)
    for variance, gain in ((1.0, noise_gain.RESTING_LEAST), (0.0, noise_gain.RESTING_MOST)):
        assert noise_gain.resting_gain(noise._replace(vector_variance=variance), 60.0) == gain
    for near, is_kept in ((1.09, True), (1.10, False), (0.90, True), (0.89, False)):
        kept = noise_gain.resting_gain(noise, near * expected)
        assert kept == pytest.approx((near if is_kept else 1.0) * expected)


@given(floats(0.5, 120.0), floats(1.0, 30.0), floats(0.0, 60.0))
def test_the_descent_ends_at_the_resting_gain(gain, resting, dt):
    K = noise_gain.descend(gain, resting, dt)
    assert min(gain, resting) * (1.0 - 1e-9) <= K <= max(gain, resting) * (1.0 + 1e-9)


def test_more_noise_of_the_vectors_lowers_the_gain_and_of_the_gyroscope_raises_it():
    """Medians: the noise of the vectors alarms the rules now and then."""
    plain, vectors, gyroscope = (
        np.median([s.gain for seed in (11, 12, 13) for s in run(scale, seed=seed)[300:]])
        for scale in (NoiseScale(), NoiseScale(vectors=5.0), NoiseScale(gyroscope=5.0))
    )
    assert vectors < plain < gyroscope
    assert plain == pytest.approx(1.8, rel=0.2)
    assert gyroscope == pytest.approx(8.6, rel=0.2)


NOISE = noise_gain.NO_NOISE._replace(samples=20.0, vector_variance=0.0025, error_floor=0.004)


@pytest.mark.parametrize(
    ("floor", "error", "expected"),
    [
        (0.004, 0.006, 0.004 + 0.02 / 1.22 * (0.006 - 0.004)),
        (0.004, 0.9, 0.004 + 0.02 / 1.22 * (3.0 * 0.004 - 0.004)),  # a wrong start counts little
        (0.004, 0.001, 0.004 + 0.02 / 1.22 * (0.001 - 0.004)),
        (0.0, 0.001, 0.5 * 0.0025),  # a vector has two components across it, e a quarter of both
    ],
)
def test_the_floor_is_a_running_mean_of_e(floor, error, expected):
    after = noise_gain.observe_floor(NOISE._replace(error_floor=floor), error, 0.02)
    assert after == NOISE._replace(error_floor=pytest.approx(expected))


@pytest.mark.parametrize("before", [2.0, 40.0])
def test_an_error_that_rises_opens_the_gain_and_one_that_falls_does_not(before):
    """It changes by six floors. The descent bounds the gain from below in both cases."""
    resting = noise_gain.resting_gain(NOISE, before)
    falls, rises = (
        noise_gain.noise_gain(NOISE, 0.002, sign * 0.024, before, 0.02) for sign in (-1.0, 1.0)
    )
    opened = noise_gain.rules_gain(resting, 0.5, 6.0)
    assert opened > 1.5 * resting
    assert falls == pytest.approx(noise_gain.descend(before, resting, 0.02))
    assert rises == pytest.approx(max(opened, falls))
