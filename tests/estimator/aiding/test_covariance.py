"""The covariance's steps against the same in plain matrices."""

import numpy as np
import pytest

from estimator.aiding.covariance import (
    expected_variance,
    learn,
    predict_covariance,
    rotation_matrix,
)
from estimator.aiding.types import ACC_BIAS, GYR_BIAS, SIZE, TURN, VELOCITY
from estimator.geometry.quaternion import normalize, rotate


def random_covariance(rng):
    root = rng.standard_normal((SIZE, SIZE))
    return root @ root.T


def random_quaternion(rng):
    return normalize(tuple(rng.standard_normal(4).tolist()))


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


@pytest.mark.parametrize("seed", range(5))
def test_rotation_matrix_turns_vectors_as_the_quaternion_does(seed):
    rng = np.random.default_rng(seed)
    q = random_quaternion(rng)
    v = rng.standard_normal(3)
    assert np.allclose(rotation_matrix(q) @ v, rotate(q, tuple(v.tolist())), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_prediction_is_f_p_f_transposed(seed):
    rng = np.random.default_rng(seed)
    P, R = random_covariance(rng), rotation_matrix(random_quaternion(rng))
    gained, dt = rng.standard_normal(3), 0.02
    F = np.eye(SIZE)
    F[TURN : TURN + 3, GYR_BIAS : GYR_BIAS + 3] = -R * dt
    F[VELOCITY : VELOCITY + 3, TURN : TURN + 3] = -skew(gained)
    F[VELOCITY : VELOCITY + 3, ACC_BIAS : ACC_BIAS + 3] = -R * dt
    before = P.copy()
    assert np.allclose(
        predict_covariance(P, R, tuple(gained.tolist()), dt), F @ P @ F.T, rtol=1e-10
    )
    assert np.array_equal(P, before)


@pytest.mark.parametrize("seed", range(5))
def test_learning_is_the_kalman_update(seed):
    rng = np.random.default_rng(seed)
    P, h, x = random_covariance(rng), rng.standard_normal(SIZE), rng.standard_normal(SIZE)
    innovation, noise = 0.7, 0.3
    S = h @ P @ h + noise
    K = P @ h / S
    wanted_x, wanted_P = x + K * (innovation - h @ x), P - np.outer(K, h @ P)
    assert expected_variance(P, h, noise) == pytest.approx(S)
    learn(P, x, h, innovation, noise)
    assert np.allclose(x, wanted_x)
    assert np.allclose(P, wanted_P)
