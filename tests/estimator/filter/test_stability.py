"""What must hold for every step of the filter: nothing overshoots, nothing diverges."""

from math import exp as exponential
from math import radians, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.filter import kernel, reference
from estimator.filter.fuzzy import fuzzy_gain
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterState
from estimator.geometry.quaternion import dot, exp, multiply, rotate_inverse, scale
from tests.estimator.filter.vehicles import FUZZY, GRAVITY, MAGNETIC, fixed, seen_from, three
from tests.vocabulary import (
    IDENTITY,
    angle_rad,
    assert_attitude_close,
    floats,
    random_quaternion,
    random_unit_vector,
    rotations,
    unit_vectors,
)

RATES_HZ = (1, 2, 4, 5, 10, 20, 25, 50, 99, 100, 101, 200, 400)
GAINS = (1, 2, 5, 10, 20, 50, 70, 101)
GAPS_S = (0.0115, 0.05, 0.5, 1.0, 7.0, 60.0)


@pytest.mark.parametrize("dt", [0.0111, *(1.0 / rate for rate in RATES_HZ if rate < 90), *GAPS_S])
def test_a_long_step_never_overshoots(backend, dt):
    """The linearised correction leaves a factor in [0, 1) of the error on every axis."""
    small = 1e-4
    truth = exp((0.3, -0.5, 0.7))
    _, axes = np.linalg.eigh(three(truth, truth, (1.0, 1.0, 1.0))[2])
    for gain in GAINS:
        for axis in axes.T:
            q = multiply(truth, exp(tuple((small * axis).tolist())))
            state = backend.correct(fixed(gain), FilterState(q), seen_from(truth), dt)
            left = multiply((truth[0], *scale(-1.0, truth[1:])), state.q_ned_frd)
            factor = 2.0 * np.dot(np.copysign(1.0, left[0]) * np.array(left[1:]), axis) / small
            # a factor of exp(-K lambda dt) below 1e-7 is lost in the second order of the angle
            assert -1e-7 <= factor < 1.0


def test_steps_are_plain_up_to_the_jitter_of_a_clock(backend):
    """A strong correction is never plain, and where the longest plain step is 0 none is."""
    K, fastest = 60.0, 1.3

    def is_plain(params, dt, gain=K):
        return backend.step_gain(params, gain, fastest, dt) == gain * dt

    for dt in (0.0025, 0.01, 0.010001, 1e-6 * 10_001, 1e-6 * 11_000):
        assert is_plain(FUZZY, dt)
    for dt in (0.0111, 0.02, 1.0):
        decay = (1.0 - exponential(-K * fastest * dt)) / fastest
        assert backend.step_gain(FUZZY, K, fastest, dt) == pytest.approx(decay, rel=1e-12)
    assert is_plain(FUZZY, 0.01, gain=1.59 / (fastest * 0.01))
    assert not is_plain(FUZZY, 0.01, gain=1.61 / (fastest * 0.01))
    assert not is_plain(FUZZY._replace(euler_step_max_s=0.0), 1e-4)


@pytest.mark.parametrize("confidence", [0.1, 1.0, 5.0, 50.0])
def test_no_confidence_makes_the_error_grow(backend, confidence):
    """Confidences multiply the rates: 50 at K = 101 and 100 Hz would be K lambda dt = 65."""
    measured = ReferenceParams(MAGNETIC, GRAVITY, confidence, confidence, confidence)
    rng = np.random.default_rng(34)
    for gain, dt in ((1, 1.0), (101, 0.01), (101, 0.0025), (101, 1.0)):
        truth = random_quaternion(rng)
        q = multiply(truth, exp(scale(0.1, random_unit_vector(rng))))
        state = backend.correct(fixed(gain), FilterState(q), seen_from(truth, measured), dt)
        assert angle_rad(state.q_ned_frd, truth) < 0.1


@settings(max_examples=300)
@given(
    rotations(),
    unit_vectors(),
    floats(1e-3, radians(179.0)),
    floats(1.0, 101.0),
    st.one_of(floats(1 / 400, 1.0), floats(1.0, 60.0)),
)
def test_no_step_makes_the_measured_error_grow(truth, axis, angle, gain, dt):
    """V = Tr(I - M R~), the paper's Lyapunov function: far from the truth the angle may grow."""
    q = multiply(truth, exp(scale(angle, axis)))

    def lyapunov(estimate):
        v, u, _ = three(estimate, truth, (1.0, 1.0, 1.0))
        return 3.0 - sum(dot(x, y) for x, y in zip(v, u, strict=True))

    state = kernel.correct(fixed(gain, gamma=0.0), FilterState(q), seen_from(truth), dt)
    assert lyapunov(state.q_ned_frd) <= lyapunov(q) * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize(
    "params", [FUZZY, fixed(1), fixed(20), fixed(101)], ids=["fuzzy", "1", "20", "101"]
)
def test_pulls_in_from_179_degrees(rate_hz, params):
    """Within 40 s at K = 1, and by a large gain within 4 s, or 20 samples."""
    rng = np.random.default_rng(35)
    for _ in range(3):
        truth = random_quaternion(rng)
        q = multiply(truth, exp(scale(radians(179.0), random_unit_vector(rng))))
        state, errors = FilterState(q), []
        for _ in range(40 * rate_hz):
            state = kernel.correct(params, state, seen_from(truth), 1.0 / rate_hz)
            errors.append(angle_rad(state.q_ned_frd, truth))
        # what is left is the swing of the bias that the long way wound up: 2.1e-4 deg at K = 1
        assert errors[-1] < radians(2.5e-4)
        if params.gain_is_fixed and params.fixed_gain >= 20.0:
            assert min(errors[: max(4 * rate_hz, 20)]) < radians(0.1)  # measured: 0.086 deg


def test_coupled_poles_lie_within_the_unit_circle():
    """The linear (attitude, bias) iteration, differentiated numerically; gaps one after another."""
    truth = IDENTITY
    for rate_hz in (*RATES_HZ, *(1.0 / gap_s for gap_s in GAPS_S)):
        for gain in GAINS:
            jacobian = np.empty((6, 6))
            for column in range(6):
                x = np.zeros(6)
                x[column] = h = 1e-6
                state = FilterState(exp(tuple(x[:3])), tuple(x[3:]))
                state = kernel.propagate(state, (0.0, 0.0, 0.0), 1.0 / rate_hz)
                state = kernel.correct(fixed(gain), state, seen_from(truth), 1.0 / rate_hz)
                w, *r = state.q_ned_frd
                turned = 2.0 * np.array(r) / w
                jacobian[:, column] = np.concatenate((turned, state.gyr_bias_rad_s)) / h
            assert np.abs(np.linalg.eigvals(jacobian)).max() < 1.0 - 1e-6


@pytest.mark.parametrize("gap_s", GAPS_S)
def test_behind_a_gap_the_fuzzy_gain_is_that_of_the_error_s_rate_over_it(backend, gap_s):
    """The paper's controller; the error grows by what the bias drifts meanwhile, and no more."""
    truth, drift = exp((0.3, -0.5, 0.7)), 0.0
    state = FilterState(multiply(truth, exp((0.05, -0.02, 0.03))))
    for number, dt in enumerate((*[0.01] * 20, gap_s, *[0.01] * 20)):
        drift += dt * sqrt(dot(state.gyr_bias_rad_s, state.gyr_bias_rad_s))
        before, rate = state, 0.0
        state = backend.propagate(state, (0.0, 0.0, 0.0), dt)
        state = backend.correct(FUZZY, state, seen_from(truth), dt)
        if number:
            share = dt / (FUZZY.rate_time_constant_s + dt)
            over = (state.error - before.error) / dt
            rate = before.error_rate_1_s + share * (over - before.error_rate_1_s)
        gain = 1.0 + fuzzy_gain(FUZZY.memberships, state.error, rate)
        assert state.gain == pytest.approx(gain, rel=1e-9)
        assert angle_rad(state.q_ned_frd, truth) < 0.07 + drift
    assert max(map(abs, state.gyr_bias_rad_s)) < 0.02


@pytest.mark.parametrize("gap_s", GAPS_S)
@pytest.mark.parametrize("gain", GAINS)
def test_a_gap_teaches_no_more_bias_than_there_is(backend, gain, gap_s):
    """The drift over a gap comes from the bias: what is learnt of it is a part, with its sign."""
    truth, bias = IDENTITY, np.array((1e-4, -2e-4, 1e-4))
    state = backend.propagate(FilterState(truth), tuple(bias), gap_s)
    state = backend.correct(fixed(gain), state, seen_from(truth), gap_s)
    _, axes = np.linalg.eigh(three(truth, truth, (1.0, 1.0, 1.0))[2])
    learnt, whole = axes.T @ state.gyr_bias_rad_s, axes.T @ bias
    # the innovation is linear to second order in the drift, 0.015 rad at most
    assert np.all(learnt / whole > -1e-3)
    assert np.all(learnt / whole < 1.0 + 1e-3)


def test_the_bias_stays_bounded(backend):
    """Vectors that contradict the gyroscope for good wind the bias up to its bound, not beyond."""
    params = fixed(1, bias_bound_rad_s=0.2, gamma=5.0)
    state = FilterState()
    for k in range(300):
        vectors = seen_from(exp((0.0, 0.0, 0.05 * k)))
        state = backend.correct(
            params, backend.propagate(state, (1.0, -1.0, 0.0), 0.05), vectors, 0.05
        )
        assert max(map(abs, state.gyr_bias_rad_s)) <= 0.2
    assert max(map(abs, state.gyr_bias_rad_s)) == 0.2


def test_gravity_alone_levels_and_leaves_the_heading(backend):
    truth = multiply(exp((0.0, 0.0, 1.2)), exp((0.2, -0.4, 0.0)))
    state = FilterState(multiply(truth, exp((0.5, 0.3, 0.0))))
    vectors = seen_from(truth)._replace(s1=0.0)
    for _ in range(400):
        state = backend.correct(fixed(10), state, vectors, 0.01)
    down = np.array(rotate_inverse(state.q_ned_frd, GRAVITY))
    np.testing.assert_allclose(down, rotate_inverse(truth, GRAVITY), atol=1e-3)
    assert state.error < 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_collinear_vectors_count_as_one_direction(backend, sign):
    """A field along gravity shows no heading; nothing is divided by zero."""
    measured = ReferenceParams(scale(sign, GRAVITY), GRAVITY, 1.0, 1.0, 1.0)
    truth = exp((0.2, -0.4, 0.0))
    state = FilterState(multiply(truth, exp((0.5, 0.3, 0.0))))
    first = backend.correct(FUZZY, state, seen_from(truth, measured), 0.0)
    u, v = rotate_inverse(state.q_ned_frd, GRAVITY), rotate_inverse(truth, GRAVITY)
    assert first.error == pytest.approx(0.5 * (1.0 - dot(u, v)), abs=1e-12)
    for _ in range(2_000):
        state = backend.correct(fixed(10), state, seen_from(truth, measured), 0.01)
        if backend is reference and state.error < 1e-8:
            break
    assert state.error < 1e-5


@pytest.mark.parametrize("angle", [1e-9, 1e-7, 0.9e-6, 1.1e-6, 1e-4])
def test_almost_collinear_vectors_keep_error_and_state_finite(backend, angle):
    tilted = (np.sin(angle), 0.0, np.cos(angle))
    measured = ReferenceParams(tilted, GRAVITY, 1.0, 1.0, 1.0)
    rng = np.random.default_rng(36)
    state = FilterState(random_quaternion(rng))
    for _ in range(20):
        state = backend.correct(FUZZY, state, seen_from(random_quaternion(rng), measured), 0.01)
        assert_attitude_close(state.q_ned_frd, state.q_ned_frd, 0.0)
        assert 0.0 <= state.error <= 1.0
        assert 1.0 <= state.gain <= 101.0


def test_no_vector_at_all_and_the_first_sample_move_nothing(backend):
    """At dt = 0 the error and the gain are set; without a vector the error is 0."""
    state, seen = FilterState(exp((0.1, 0.2, 0.3)), (0.1, 0.0, 0.0)), seen_from(IDENTITY)
    absent = seen._replace(s1=0.0, s2=0.0)
    for vectors, dt in ((absent, 0.0), (absent, 0.01), (absent, 1.0), (seen, 0.0)):
        after = backend.correct(FUZZY, state, vectors, dt)
        assert_attitude_close(after.q_ned_frd, state.q_ned_frd, 1e-15)
        assert after.gyr_bias_rad_s == state.gyr_bias_rad_s
        assert (after.error > 0.0) == (vectors is seen)
        assert after.error >= 0.0
    assert after.gain > 1.0
    assert (after.error_rate_1_s, after.has_error) == (0.0, True)  # the first error has no rate
