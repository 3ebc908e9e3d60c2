"""The filter, readable and compiled: each against the other and against the paper's formulas."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.simulation.simulated_vehicle import simulate
from estimator.filter import kernel, reference
from estimator.filter.noise_gain import NO_NOISE, NoiseState
from estimator.filter.observation import raw_vectors
from estimator.filter.types import FilterParams, FilterState, Vectors
from estimator.geometry.quaternion import cross, dot, exp, multiply, unit
from estimator.types import Sample
from tests.estimator.filter.vehicles import FUZZY, GRAVITY, MAGNETIC, PAPER, fixed, seen_from, three
from tests.paper_noise import samples_of
from tests.vocabulary import (
    angle_rad,
    assert_attitude_close,
    floats,
    random_memberships,
    random_quaternion,
    random_unit_vector,
    rotations,
    scipy_rotation,
)


def random_vectors(rng):
    """Measured and inertial directions that need not fit each other, with any confidences."""
    s1, s2, s3 = (rng.uniform(0.0, 5.0, 3) * (rng.random(3) < 0.8)).tolist()
    v = [random_unit_vector(rng) for _ in range(4)]
    return Vectors(v[0], v[1], s1, v[2], v[3], s2, s3)


def random_state(rng):
    bias, rate = (tuple(rng.uniform(-most, most, 3).tolist()) for most in (0.5, 1.0))
    error_rate_gain = rng.uniform((0.0, -1.0, 1.0), (1.0, 1.0, 101.0)).tolist()
    q, has_error, noise = random_quaternion(rng), bool(rng.random() < 0.9), random_noise(rng)
    return FilterState(q, bias, *error_rate_gain, has_error, rate, noise)


def random_noise(rng):
    """What may be remembered of earlier samples, or nothing."""
    if rng.random() < 0.2:
        return NO_NOISE
    first, second = ((random_unit_vector(rng), bool(rng.random() < 0.8)) for _ in range(2))
    turn, samples = tuple(rng.uniform(-1.0, 1.0, 3).tolist()), float(rng.integers(1, 50))
    variances = (10.0 ** rng.uniform(-6.0, -1.0, 3)).tolist()
    return NoiseState(*first, *second, turn, samples, *variances)


def numbers(state):
    """All of a state in one row, but its attitude."""
    state = state._asdict()
    del state["q_ned_frd"]
    return np.hstack([np.ravel(value) for value in (*state.pop("noise"), *state.values())])


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


@pytest.mark.parametrize("first_step_s", [0.0, 0.003, 0.01])
def test_batch_is_the_single_step_repeated(first_step_s):
    """But for the first correction, which lasts for as long as the parameters ask."""
    params, start = FUZZY._replace(first_step_s=first_step_s), FilterState(exp((3.1, 0.1, 0.2)))
    signals = simulate(8, 200)
    columns = (signals.gyr_rad_s, signals.acc_m_s2, signals.mag_gauss)
    estimates, gains = kernel.run(params, PAPER, start, *columns, 0.01)
    for k, (_, gyr, acc, mag, _) in enumerate(samples_of(signals)):
        vectors = raw_vectors(PAPER, acc, mag, True)
        if k == 0:
            propagated = start
            state = kernel.correct(params, start, vectors, first_step_s)
        else:
            propagated = kernel.propagate(state, gyr, 0.01)
            state = kernel.step(params, PAPER, state, Sample(gyr, acc, mag, True, 0.01))
            assert state == kernel.correct(params, propagated, vectors, 0.01)
        assert tuple(estimates[k].tolist()) == propagated.q_ned_frd
        assert gains[k] == state.gain


S = (0.7, 1.3, 0.4)
WEIGHED = PAPER._replace(s_magnetic=S[0], s_gravity=S[1], s_cross=S[2])


@given(rotations(), rotations())
def test_the_innovation_is_vex_of_the_antisymmetric_part(q, truth):
    """sum s_i/2 (v_hat_i x v_i) = vex(Pa(M R~)), R~ = R^T R_hat; seen through one step's turn."""
    v, u, M = three(q, truth, S)
    A = M @ (scipy_rotation(truth).inv() * scipy_rotation(q)).as_matrix()
    expected = 0.5 * (A - A.T)[[2, 0, 1], [1, 2, 0]]
    ours = reference.innovation(np.array(v), np.array(u), np.array(S))
    np.testing.assert_allclose(ours, expected, atol=1e-13)
    vectors = seen_from(truth, WEIGHED)
    for form in (reference, kernel):
        state = form.correct(fixed(2.0), FilterState(q), vectors, 0.001)
        turned = multiply(q, exp(tuple(-2.0 * 0.001 * expected)))
        assert_attitude_close(state.q_ned_frd, turned, 1e-12)
        bias = 0.5 * FUZZY.gamma * 0.001 * expected
        np.testing.assert_allclose(state.gyr_bias_rad_s, bias, atol=1e-15)


@given(rotations(), rotations())
def test_measured_error_is_the_papers_trace_and_the_true_error(q, truth):
    v, u, M = three(q, truth, S)
    right = sum(w * np.outer(x, y) for w, x, y in zip(S, v, u, strict=True))
    by_trace = (3.0 - np.trace(np.linalg.inv(M) @ right)) / 4.0
    true = np.sin(0.5 * angle_rad(q, truth)) ** 2
    assert by_trace == pytest.approx(true, abs=1e-12)
    vectors = seen_from(truth, WEIGHED)
    for form in (reference, kernel):
        state = form.correct(fixed(1.0), FilterState(q), vectors, 0.0)
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


@given(rotations(), st.tuples(*[floats(-10.0, 10.0)] * 3), floats(0.0, 1.0))
def test_propagation_is_the_exponential_map(q, gyr, dt):
    for form in (reference, kernel):
        bias = (0.1, -0.2, 0.3)
        state = FilterState(q, bias)
        turned = form.propagate(state, gyr, dt)
        phi = dt * (np.array(gyr) - bias)
        theirs = scipy_rotation(q) * scipy_rotation(exp(tuple(phi.tolist())))
        expected = tuple(theirs.as_quat(scalar_first=True).tolist())
        assert_attitude_close(turned.q_ned_frd, expected, 1e-13)
        rate = tuple((np.array(gyr) - bias).tolist())
        assert turned.rate_rad_s == pytest.approx(rate, abs=1e-15)
        assert turned._replace(q_ned_frd=q, rate_rad_s=state.rate_rad_s) == state


def test_raw_vectors_are_the_papers():
    vectors = raw_vectors(PAPER, (0.0, 0.0, -9.8), (0.3, -0.3, 0.3), True)
    assert vectors.v2_frd == pytest.approx(GRAVITY)  # at rest and level gravity points down
    assert vectors.v1_frd == pytest.approx(MAGNETIC)
    vectors = raw_vectors(WEIGHED, (0.0, 0.0, -9.8), (0.3, -0.3, 0.3), True)
    assert (vectors.s1, vectors.s2, vectors.s3) == S
    assert raw_vectors(PAPER, (0.0, 0.0, -9.8), (0.3, 0.0, 0.0), False).s1 == 0.0
    assert raw_vectors(PAPER, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0), True).s1 == 0.0
    assert raw_vectors(PAPER, (0.0, 0.0, 0.0), (0.3, 0.0, 0.0), True).s2 == 0.0
