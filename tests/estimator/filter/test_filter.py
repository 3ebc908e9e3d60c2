"""The filter, readable and compiled: the same tests for both, and each against the other."""

from math import exp as exponential
from math import isfinite, radians, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.filter import kernel, reference
from estimator.filter.memberships import midpoint
from estimator.filter.noise_gain import NO_NOISE, NoiseState
from estimator.filter.observation import ReferenceParams, raw_vectors
from estimator.filter.types import NO_DECAY, FilterParams, FilterState, Vectors, initial_state
from estimator.geometry.quaternion import cross, dot, exp, multiply, rotate_inverse, scale, unit
from estimator.types import Sample
from tests.vocabulary import (
    IDENTITY,
    angle_rad,
    assert_attitude_close,
    floats,
    random_memberships,
    random_quaternion,
    random_unit_vector,
    rotations,
    scipy_rotation,
    unit_vectors,
)

MAGNETIC = unit((1.0, -1.0, 1.0))
GRAVITY = (0.0, 0.0, 1.0)
PAPER = ReferenceParams(MAGNETIC, GRAVITY, 1.0, 1.0, 1.0)
FUZZY = FilterParams(
    gamma=1.0,
    bias_bound_rad_s=2.0,
    rate_time_constant_s=0.3,
    euler_step_max_s=0.01,
    first_step_s=0.01,
    memberships=midpoint(),
    gain_is_fixed=False,
    fixed_gain=1.0,
    gain_knows_noise=False,
)
RATES_HZ = (1, 2, 4, 5, 10, 20, 25, 50, 99, 100, 101, 200, 400)
GAINS = (1, 2, 5, 10, 20, 50, 70, 101)
GAPS_S = (0.0115, 0.05, 0.5, 1.0, 7.0, 60.0)


@pytest.fixture(params=[reference, kernel], ids=["reference", "kernel"])
def backend(request):
    return request.param


def fixed(gain, **changes):
    return FUZZY._replace(gain_is_fixed=True, fixed_gain=float(gain), **changes)


def seen_from(q, measured=PAPER):
    """What a perfect vehicle of attitude ``q`` measures."""
    v1 = rotate_inverse(q, measured.magnetic_ned)
    v2 = rotate_inverse(q, measured.gravity_ned)
    s1, s2, s3 = measured.s_magnetic, measured.s_gravity, measured.s_cross
    return Vectors(v1, measured.magnetic_ned, s1, v2, measured.gravity_ned, s2, s3)


def random_vectors(rng):
    """Measured and inertial directions that need not fit each other, with any confidences."""
    s1, s2, s3 = (rng.uniform(0.0, 5.0, 3) * (rng.random(3) < 0.8)).tolist()
    v = [random_unit_vector(rng) for _ in range(4)]
    return Vectors(v[0], v[1], s1, v[2], v[3], s2, s3)


def random_state(rng):
    bias = tuple(rng.uniform(-0.5, 0.5, 3).tolist())
    error, rate = rng.uniform(0.0, 1.0), rng.uniform(-1.0, 1.0)
    return FilterState(
        random_quaternion(rng),
        bias,
        error,
        rate,
        rng.uniform(1.0, 101.0),
        bool(rng.random() < 0.9),
        tuple(rng.uniform(-1.0, 1.0, 3).tolist()),
        random_noise(rng),
    )


def random_noise(rng):
    """What may be remembered of earlier samples, or nothing."""
    if rng.random() < 0.2:
        return NO_NOISE
    return NoiseState(
        random_unit_vector(rng),
        bool(rng.random() < 0.8),
        random_unit_vector(rng),
        bool(rng.random() < 0.8),
        tuple(rng.uniform(-1.0, 1.0, 3).tolist()),
        float(rng.integers(1, 50)),
        *(10.0 ** rng.uniform(-6.0, -1.0, 3)).tolist(),
    )


def numbers(state):
    """All of a state in one row, but its attitude and the decay that the kernel remembers."""
    state = state._asdict()
    del state["q_ned_frd"], state["decay"]
    return np.hstack([np.ravel(value) for value in (*state.pop("noise"), *state.values())])


@pytest.mark.parametrize("K", [20.0, 1.0])
def test_a_step_takes_the_decay_of_its_own_length(K):
    """A decay that is remembered serves steps of its own length and gain only."""
    params = FUZZY._replace(gain_is_fixed=True, fixed_gain=K, euler_step_max_s=0.0)
    rng = np.random.default_rng(5)
    state, vectors = random_state(rng), random_vectors(rng)
    for dt in (0.01, 0.01, 0.02, 0.01):
        alone = kernel.correct(params, state._replace(decay=NO_DECAY), vectors, dt)
        state = kernel.correct(params, state, vectors, dt)
        assert state == alone
    other = kernel.correct(params._replace(fixed_gain=2.0 * K), state, vectors, 0.01)
    assert other.decay == pytest.approx((2.0 * state.decay[0], -np.expm1(-2.0 * state.decay[0])))


def random_params(rng):
    return FilterParams(
        gamma=rng.uniform(0.0, 3.0),
        bias_bound_rad_s=rng.uniform(0.0, 1.0),
        rate_time_constant_s=rng.uniform(0.01, 1.0),
        euler_step_max_s=rng.choice([0.0, 0.01]),
        first_step_s=0.01,
        memberships=random_memberships(rng),
        gain_is_fixed=bool(rng.random() < 0.3),
        fixed_gain=rng.uniform(1.0, 101.0),
        gain_knows_noise=bool(rng.random() < 0.3),
    )


def error_after(backend, params, q, truth, dt, steps=1):
    """Error angles after each correction while the vehicle rests at ``truth``."""
    state = initial_state(q)
    errors = []
    for _ in range(steps):
        state = backend.correct(params, state, seen_from(truth), dt)
        errors.append(angle_rad(state.q_ned_frd, truth))
    return errors


# The readable and the compiled form agree.


def test_both_forms_agree_on_random_states():
    """Roundings grow with the correction, K dt |w|, and the slopes of the fuzzy sets."""
    rng = np.random.default_rng(30)
    for _ in range(1_500):
        params, state, vectors = random_params(rng), random_state(rng), random_vectors(rng)
        gyr = tuple(rng.uniform(-20.0, 20.0, 3).tolist())
        dt = float(rng.choice([0.0, 0.0025, 0.01, 0.02, 0.2, 1.0, 60.0]))
        plain, fast = (
            form.correct(params, form.propagate(state, gyr, dt), vectors, dt)
            for form in (reference, kernel)
        )
        assert_attitude_close(plain.q_ned_frd, fast.q_ned_frd, 1e-9)
        assert numbers(plain) == pytest.approx(numbers(fast), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("params", [FUZZY, FUZZY._replace(gain_knows_noise=True)])
def test_both_forms_agree_over_the_papers_experiment(params):
    """300 samples of the paper's noisy signals, state handed on; roundings grow with the steps."""
    from drivers.simulation.simulated_vehicle import simulate

    signals = simulate(7, 300)
    plain = fast = initial_state(exp((3.1, 0.1, 0.2)))
    for k in range(300):
        gyr, acc, mag = (
            tuple(column[k].tolist())
            for column in (signals.gyr_rad_s, signals.acc_m_s2, signals.mag_gauss)
        )
        vectors = raw_vectors(PAPER, acc, mag, True)
        plain = reference.correct(params, reference.propagate(plain, gyr, 0.01), vectors, 0.01)
        fast = kernel.step(params, PAPER, fast, Sample(gyr, acc, mag, True, 0.01))
        assert_attitude_close(plain.q_ned_frd, fast.q_ned_frd, 1e-8)
        assert plain.gain == pytest.approx(fast.gain, rel=1e-6)


def test_batch_is_the_single_step_repeated():
    from drivers.simulation.simulated_vehicle import simulate

    signals = simulate(8, 200)
    start = initial_state(exp((3.1, 0.1, 0.2)))
    columns = (signals.gyr_rad_s, signals.acc_m_s2, signals.mag_gauss)
    estimates, gains = kernel.run(FUZZY, PAPER, start, *columns, 0.01)
    state = start
    for k in range(200):
        gyr, acc, mag = (tuple(column[k].tolist()) for column in columns)
        if k > 0:
            state = kernel.propagate(state, gyr, 0.01)
        assert tuple(estimates[k].tolist()) == state.q_ned_frd
        state = kernel.correct(FUZZY, state, raw_vectors(PAPER, acc, mag, True), 0.01)
        assert gains[k] == state.gain


def test_batch_takes_the_first_correction_for_as_long_as_the_parameters_ask():
    """No step (0) leaves the second sample's estimate at the start, 0.01 s moves it by K w dt."""
    from drivers.simulation.simulated_vehicle import simulate

    signals = simulate(8, 2)
    start = initial_state(exp((1.0, 0.1, 0.2)))
    _, acc, mag = still = (np.zeros((2, 3)), signals.acc_m_s2, signals.mag_gauss)
    for step_s in (0.0, 0.003, 0.01):
        params = FUZZY._replace(first_step_s=step_s)
        estimates, _ = kernel.run(params, PAPER, start, *still, 0.01)
        first = raw_vectors(PAPER, tuple(acc[0].tolist()), tuple(mag[0].tolist()), True)
        moved = kernel.correct(params, start, first, step_s)
        expected = kernel.propagate(moved, (0.0, 0.0, 0.0), 0.01).q_ned_frd
        assert tuple(estimates[1].tolist()) == expected
        assert (angle_rad(moved.q_ned_frd, start.q_ned_frd) > 1e-12) == (step_s > 0.0)


# The steps against the paper's formulas, written out here once more.


def vex(A):
    return np.array([A[2, 1], A[0, 2], A[1, 0]])


def three(q, truth, s):
    """Measured and estimated triples and M = sum s_i v_i v_i^T for exact measurements."""
    v = [rotate_inverse(truth, MAGNETIC), rotate_inverse(truth, GRAVITY)]
    u = [rotate_inverse(q, MAGNETIC), rotate_inverse(q, GRAVITY)]
    v.append(unit(cross(*v)))
    u.append(unit(cross(*u)))
    return v, u, sum(w * np.outer(x, x) for w, x in zip(s, v, strict=True))


@given(rotations(), rotations())
def test_the_innovation_is_vex_of_the_antisymmetric_part(q, truth):
    """sum s_i/2 (v_hat_i x v_i) = vex(Pa(M R~)), R~ = R^T R_hat; seen through one step's turn."""
    s = (0.7, 1.3, 0.4)
    v, u, M = three(q, truth, s)
    A = M @ (scipy_rotation(truth).inv() * scipy_rotation(q)).as_matrix()
    expected = vex(0.5 * (A - A.T))
    ours = reference.innovation(np.array(v), np.array(u), np.array(s))
    np.testing.assert_allclose(ours, expected, atol=1e-13)
    vectors = seen_from(truth, PAPER._replace(s_magnetic=s[0], s_gravity=s[1], s_cross=s[2]))
    for form in (reference, kernel):
        state = form.correct(fixed(2.0), initial_state(q), vectors, 0.001)
        turned = multiply(q, exp(tuple(-2.0 * 0.001 * expected)))
        assert_attitude_close(state.q_ned_frd, turned, 1e-12)
        bias = 0.5 * FUZZY.gamma * 0.001 * expected
        np.testing.assert_allclose(state.gyr_bias_rad_s, bias, atol=1e-15)


@given(rotations(), rotations())
def test_measured_error_is_the_papers_trace_and_the_true_error(q, truth):
    s = (0.7, 1.3, 0.4)
    v, u, M = three(q, truth, s)
    right = sum(w * np.outer(x, y) for w, x, y in zip(s, v, u, strict=True))
    by_trace = (3.0 - np.trace(np.linalg.inv(M) @ right)) / 4.0
    true = np.sin(0.5 * angle_rad(q, truth)) ** 2
    assert by_trace == pytest.approx(true, abs=1e-12)
    vectors = seen_from(truth, PAPER._replace(s_magnetic=s[0], s_gravity=s[1], s_cross=s[2]))
    for form in (reference, kernel):
        state = form.correct(fixed(1.0), initial_state(q), vectors, 0.0)
        assert state.error == pytest.approx(true, abs=1e-12)


def test_largest_rate_is_the_largest_eigenvalue():
    rng = np.random.default_rng(32)
    for _ in range(500):
        v1, v2 = random_unit_vector(rng), random_unit_vector(rng)
        s1, s2, s3 = (rng.uniform(0.0, 5.0, 3) * (rng.random(3) < 0.8)).tolist()
        v = np.array((v1, v2, unit(cross(v1, v2))))
        s = np.array((s1, s2, s3))
        M = (v.T * s) @ v
        eigenvalues = np.linalg.eigvals(0.5 * (np.trace(M) * np.eye(3) - M)).real
        ours = kernel.largest_rate(dot(v1, v2), s1, s2, s3)
        assert ours == pytest.approx(eigenvalues.max(), abs=1e-12)
        assert reference.largest_rate(v, s) == pytest.approx(eigenvalues.max(), abs=1e-12)


def test_error_rate_is_a_low_passed_signed_derivative(backend):
    """A steady slope of -0.2 1/s is found with its sign; after one tau, 63 % of it."""
    dt, tau = 0.001, 0.3
    state = initial_state()._replace(error=0.9, has_error=True)
    for k in range(1, 301):
        error = 0.9 - 0.2 * k * dt
        rate = backend.error_rate(FUZZY, state, error, dt)
        state = state._replace(error=error, error_rate_1_s=rate)
    assert rate == pytest.approx(-0.2 * (1.0 - exponential(-300 * dt / tau)), rel=2e-3)
    # noise that alternates leaves no rate: the derivative is signed, not rectified
    state = initial_state()._replace(error=0.1, has_error=True)
    for k in range(3_000):
        error = 0.1 + 0.01 * (-1.0) ** k
        rate = backend.error_rate(FUZZY, state, error, 0.01)
        state = state._replace(error=error, error_rate_1_s=rate)
    assert abs(rate) < 0.05  # the jumps are 2 1/s, passed on by dt/(tau + dt) = 0.03


def test_first_error_has_no_rate(backend):
    state = backend.correct(FUZZY, initial_state(exp((1.0, 0.0, 0.0))), seen_from(IDENTITY), 0.01)
    assert state.error_rate_1_s == 0.0
    assert state.has_error


@given(rotations(), st.tuples(*[floats(-10.0, 10.0)] * 3), floats(0.0, 1.0))
def test_propagation_is_the_exponential_map(q, gyr, dt):
    for form in (reference, kernel):
        bias = (0.1, -0.2, 0.3)
        state = initial_state(q, bias)
        turned = form.propagate(state, gyr, dt)
        phi = dt * (np.array(gyr) - bias)
        theirs = scipy_rotation(q) * scipy_rotation(exp(tuple(phi.tolist())))
        expected = tuple(theirs.as_quat(scalar_first=True).tolist())
        assert_attitude_close(turned.q_ned_frd, expected, 1e-13)
        rate = tuple((np.array(gyr) - bias).tolist())
        assert turned.rate_rad_s == pytest.approx(rate, abs=1e-15)
        assert turned._replace(q_ned_frd=q, rate_rad_s=state.rate_rad_s) == state


# What must hold for every step: nothing overshoots, nothing diverges.


@pytest.mark.parametrize("dt", [0.0111, *(1.0 / rate for rate in RATES_HZ if rate < 90), *GAPS_S])
def test_a_long_step_never_overshoots(backend, dt):
    """The linearised correction leaves a factor in [0, 1) of the error on every axis."""
    small = 1e-4
    truth = exp((0.3, -0.5, 0.7))
    v1, v2 = rotate_inverse(truth, MAGNETIC), rotate_inverse(truth, GRAVITY)
    frame = np.array((v1, v2, unit(cross(v1, v2))))
    M = frame.T @ frame
    _, axes = np.linalg.eigh(M)
    for gain in GAINS:
        for axis in axes.T:
            q = multiply(truth, exp(tuple((small * axis).tolist())))
            state = backend.correct(fixed(gain), initial_state(q), seen_from(truth), dt)
            left = multiply((truth[0], *scale(-1.0, truth[1:])), state.q_ned_frd)
            factor = 2.0 * np.dot(np.copysign(1.0, left[0]) * np.array(left[1:]), axis) / small
            # a factor of exp(-K lambda dt) below 1e-7 is lost in the second order of the angle
            assert -1e-7 <= factor < 1.0


def test_steps_are_plain_up_to_the_jitter_of_a_clock(backend):
    """10.001 ms and, from stamps in whole milliseconds, 11 ms count as 10; 11.1 ms decays.

    A strong correction is never plain, and where the longest plain step is 0 none is.
    """
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


@pytest.mark.parametrize("rate_hz", [rate for rate in RATES_HZ if rate >= 90])
def test_a_short_step_contracts(backend, rate_hz):
    """Plain steps may pass the truth, but only by less than the error there was."""
    rng = np.random.default_rng(33)
    for gain in (*GAINS, 200, 1000):
        for _ in range(10):
            truth = random_quaternion(rng)
            q = multiply(truth, exp(scale(1e-3, random_unit_vector(rng))))
            (after,) = error_after(backend, fixed(gain), q, truth, 1.0 / rate_hz)
            assert after < 0.999 * 1e-3


@pytest.mark.parametrize("confidence", [0.1, 1.0, 5.0, 50.0])
def test_no_confidence_makes_the_error_grow(backend, confidence):
    """Confidences multiply the rates: 50 at K = 101 and 100 Hz would be K lambda dt = 65."""
    measured = ReferenceParams(MAGNETIC, GRAVITY, confidence, confidence, confidence)
    rng = np.random.default_rng(34)
    for gain, dt in ((1, 1.0), (101, 0.01), (101, 0.0025), (101, 1.0)):
        truth = random_quaternion(rng)
        q = multiply(truth, exp(scale(0.1, random_unit_vector(rng))))
        state = backend.correct(fixed(gain), initial_state(q), seen_from(truth, measured), dt)
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
    """From anywhere: V = Tr(I - M R~), the paper's Lyapunov function, does not grow.

    V and not the angle: far from the truth the weights of the axes differ,
    and the way down V may lead along an axis on which the angle rises.
    """
    q = multiply(truth, exp(scale(angle, axis)))

    def lyapunov(estimate):
        v, u, _ = three(estimate, truth, (1.0, 1.0, 1.0))
        return 3.0 - sum(dot(x, y) for x, y in zip(v, u, strict=True))

    state = kernel.correct(fixed(gain, gamma=0.0), initial_state(q), seen_from(truth), dt)
    assert lyapunov(state.q_ned_frd) <= lyapunov(q) * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize(
    "params", [FUZZY, fixed(1), fixed(20), fixed(101)], ids=["fuzzy", "1", "20", "101"]
)
def test_pulls_in_from_179_degrees(rate_hz, params):
    """Within 40 s at K = 1 (rate 0.71 1/s at least, slower near the opposite attitude).

    Large gains need 4 s, or 20 samples: a long step corrects as far as a decay
    would, which near the opposite attitude is about twice the sine of the error.
    """
    rng = np.random.default_rng(35)
    for _ in range(3):
        truth = random_quaternion(rng)
        q = multiply(truth, exp(scale(radians(179.0), random_unit_vector(rng))))
        errors = error_after(kernel, params, q, truth, 1.0 / rate_hz, 40 * rate_hz)
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
                state = initial_state(exp(tuple(x[:3])), tuple(x[3:]))
                state = kernel.propagate(state, (0.0, 0.0, 0.0), 1.0 / rate_hz)
                state = kernel.correct(fixed(gain), state, seen_from(truth), 1.0 / rate_hz)
                w, *r = state.q_ned_frd
                turned = 2.0 * np.array(r) / w
                jacobian[:, column] = np.concatenate((turned, state.gyr_bias_rad_s)) / h
            assert np.abs(np.linalg.eigvals(jacobian)).max() < 1.0 - 1e-6


@pytest.mark.parametrize("gap_s", GAPS_S)
def test_a_gap_does_not_throw_the_filter_off(backend, gap_s):
    """A resting vehicle, silent for a while: the error grows by what the bias drifts, no more."""
    truth = exp((0.3, -0.5, 0.7))
    for params in (FUZZY, fixed(1), fixed(101)):
        state = initial_state(multiply(truth, exp((0.05, -0.02, 0.03))))
        vectors = seen_from(truth)
        drift = 0.0
        for dt in (*[0.01] * 20, gap_s, *[0.01] * 20):
            # what the bias learnt so far drifts over the gap, and is corrected by some part of it
            drift += dt * sqrt(dot(state.gyr_bias_rad_s, state.gyr_bias_rad_s))
            state = backend.correct(params, backend.propagate(state, (0.0,) * 3, dt), vectors, dt)
            assert angle_rad(state.q_ned_frd, truth) < 0.07 + drift
        assert max(map(abs, state.gyr_bias_rad_s)) < 0.02


@pytest.mark.parametrize("gap_s", GAPS_S)
@pytest.mark.parametrize("gain", GAINS)
def test_a_gap_teaches_no_more_bias_than_there_is(backend, gain, gap_s):
    """The drift over a gap comes from the bias: what is learnt of it is a part, with its sign."""
    truth, bias = IDENTITY, np.array((1e-4, -2e-4, 1e-4))
    state = backend.propagate(initial_state(truth), tuple(bias), gap_s)
    state = backend.correct(fixed(gain), state, seen_from(truth), gap_s)
    v = np.array((MAGNETIC, GRAVITY, unit(cross(MAGNETIC, GRAVITY))))
    _, axes = np.linalg.eigh(v.T @ v)
    learnt, whole = axes.T @ state.gyr_bias_rad_s, axes.T @ bias
    # the innovation is linear to second order in the drift, 0.015 rad at most
    assert np.all(learnt / whole > -1e-3)
    assert np.all(learnt / whole < 1.0 + 1e-3)


def test_the_bias_stays_bounded(backend):
    """Vectors that contradict the gyroscope for good wind the bias up to its bound, not beyond."""
    params = fixed(1, bias_bound_rad_s=0.2, gamma=5.0)
    state = initial_state()
    for k in range(300):
        vectors = seen_from(exp((0.0, 0.0, 0.05 * k)))
        state = backend.correct(
            params, backend.propagate(state, (1.0, -1.0, 0.0), 0.05), vectors, 0.05
        )
        assert max(map(abs, state.gyr_bias_rad_s)) <= 0.2
    assert max(map(abs, state.gyr_bias_rad_s)) == 0.2


# What is missing or degenerate.


def test_gravity_alone_levels_and_leaves_the_heading(backend):
    heading = exp((0.0, 0.0, 1.2))
    truth = multiply(heading, exp((0.2, -0.4, 0.0)))
    state = initial_state(multiply(truth, exp((0.5, 0.3, 0.0))))
    vectors = seen_from(truth)._replace(s1=0.0)
    for _ in range(400):
        state = backend.correct(fixed(10), state, vectors, 0.01)
    down = np.array(rotate_inverse(state.q_ned_frd, GRAVITY))
    np.testing.assert_allclose(down, rotate_inverse(truth, GRAVITY), atol=1e-3)
    assert state.error < 1e-6


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_collinear_vectors_count_as_one_direction(backend, sign):
    """A field along gravity shows no heading; nothing is divided by zero."""
    along = scale(sign, GRAVITY)
    measured = ReferenceParams(along, GRAVITY, 1.0, 1.0, 1.0)
    truth = exp((0.2, -0.4, 0.0))
    state = initial_state(multiply(truth, exp((0.5, 0.3, 0.0))))
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
    state = initial_state(random_quaternion(rng))
    for _ in range(20):
        state = backend.correct(FUZZY, state, seen_from(random_quaternion(rng), measured), 0.01)
        assert_attitude_close(state.q_ned_frd, state.q_ned_frd, 0.0)
        assert 0.0 <= state.error <= 1.0
        assert 1.0 <= state.gain <= 101.0


def test_no_vector_at_all_changes_nothing_but_the_error(backend):
    state = initial_state(exp((0.1, 0.2, 0.3)), (0.1, 0.0, 0.0))
    vectors = seen_from(IDENTITY)._replace(s1=0.0, s2=0.0)
    for dt in (0.0, 0.01, 1.0):
        after = backend.correct(FUZZY, state, vectors, dt)
        assert_attitude_close(after.q_ned_frd, state.q_ned_frd, 1e-15)
        assert after.gyr_bias_rad_s == state.gyr_bias_rad_s
        assert after.error == 0.0


def test_the_first_sample_moves_nothing(backend):
    """At dt = 0 the error and the gain are set; attitude and bias stay."""
    state = initial_state(exp((0.1, 0.2, 0.3)))
    after = backend.correct(FUZZY, state, seen_from(IDENTITY), 0.0)
    assert_attitude_close(after.q_ned_frd, state.q_ned_frd, 1e-15)
    assert after.gyr_bias_rad_s == (0.0, 0.0, 0.0)
    assert after.error > 0.0
    assert after.gain > 1.0


wide = st.one_of(floats(-1e300, 1e300), floats(-400.0, 400.0), floats(-1e-300, 1e-300))


@given(
    st.tuples(*[floats(-70.0, 70.0)] * 3),
    st.tuples(*[floats(-400.0, 400.0)] * 3),
    st.tuples(wide, wide, wide),
    st.booleans(),
    floats(0.0, 1e9),
    rotations(),
)
def test_kept_finite_for_any_sample_that_is_let_through(gyr, acc, mag, has_mag, dt, q):
    state = initial_state(q)
    for _ in range(3):
        state = kernel.step(FUZZY, PAPER, state, Sample(gyr, acc, mag, has_mag, dt))
        assert_attitude_close(state.q_ned_frd, state.q_ned_frd, 0.0)
        assert all(isfinite(x) for x in state.gyr_bias_rad_s)
        assert 0.0 <= state.error <= 1.0
        assert 1.0 <= state.gain <= 101.0


def test_raw_vectors_are_the_papers():
    vectors = raw_vectors(PAPER, (0.0, 0.0, -9.8), (0.3, -0.3, 0.3), True)
    assert vectors.v2_frd == pytest.approx(GRAVITY)  # at rest and level gravity points down
    assert vectors.v1_frd == pytest.approx(MAGNETIC)
    weighed = PAPER._replace(s_magnetic=0.2, s_gravity=0.3, s_cross=0.4)
    vectors = raw_vectors(weighed, (0.0, 0.0, -9.8), (0.3, -0.3, 0.3), True)
    assert (vectors.s1, vectors.s2, vectors.s3) == (0.2, 0.3, 0.4)
    assert raw_vectors(PAPER, (0.0, 0.0, -9.8), (0.3, 0.0, 0.0), False).s1 == 0.0
    assert raw_vectors(PAPER, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0), True).s1 == 0.0
    assert raw_vectors(PAPER, (0.0, 0.0, 0.0), (0.3, 0.0, 0.0), True).s2 == 0.0


def test_opposite_quaternions_give_one_filter(backend):
    rng = np.random.default_rng(37)
    for _ in range(50):
        q, vectors = random_quaternion(rng), random_vectors(rng)
        minus = tuple(-x for x in q)
        one, other = (backend.correct(FUZZY, initial_state(p), vectors, 0.01) for p in (q, minus))
        assert_attitude_close(one.q_ned_frd, other.q_ned_frd, 1e-12)
        assert one.gain == other.gain
        assert one.gyr_bias_rad_s == other.gyr_bias_rad_s
