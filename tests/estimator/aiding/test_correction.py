"""Corrections are added to what they are errors of: true value = estimate + error."""

import numpy as np
import pytest

from estimator.aiding.beginning import blank_aiding, forget_biases
from estimator.aiding.correction import apply_corrections
from estimator.aiding.inertial import Prediction
from estimator.aiding.types import ACC_BIAS, GYR_BIAS, SIZE, TURN, AidingParams
from estimator.aiding.velocity_history import new_velocity_history
from estimator.geometry.quaternion import exp, multiply, rotate
from estimator.types import ZERO_VEC3
from tests.vocabulary import assert_attitude_close

Q = exp((0.4, -0.9, 1.3))
FORCE = (1.0, 2.0, -9.0)


@pytest.fixture
def estimate():
    return blank_aiding(AidingParams())[0].estimate


def prediction(estimate):
    estimate = estimate._replace(q_ned_frd=Q, velocity_ned_m_s=(5.0, -3.0, 1.0))
    return Prediction(
        estimate, FORCE, ZERO_VEC3, new_velocity_history(ZERO_VEC3), np.zeros((SIZE, SIZE))
    )


def numbers(estimate):
    """Everything but the attitude and what nobody learns, in the order of the errors."""
    parts = [np.atleast_1d(np.asarray(part)) for part in estimate[1:-1]]
    return np.concatenate(parts)


@pytest.mark.parametrize("error", range(3, SIZE))
def test_each_error_corrects_its_own_number_and_no_other(estimate, error):
    """The estimate's fields are in the order of the errors, which begin with the turn."""
    now = prediction(estimate)
    before = apply_corrections(now, np.zeros(SIZE)).estimate
    x = np.zeros(SIZE)
    x[error] = 0.01
    after = apply_corrections(now, x).estimate
    assert after.q_ned_frd == before.q_ned_frd
    expected = np.zeros(SIZE - 3)
    expected[error - 3] = 0.01
    np.testing.assert_allclose(numbers(after) - numbers(before), expected, atol=1e-15)


def test_a_turn_is_about_the_axes_of_ned_and_takes_the_force_along(estimate):
    x = np.zeros(SIZE)
    x[TURN : TURN + 3] = turn = (0.02, -0.01, 0.03)
    after = apply_corrections(prediction(estimate), x)
    assert_attitude_close(after.estimate.q_ned_frd, multiply(exp(turn), Q), 1e-12)
    np.testing.assert_allclose(after.force_ned_m_s2, rotate(exp(turn), FORCE), atol=1e-12)


def test_a_bias_of_the_accelerometer_comes_off_the_force(estimate):
    x = np.zeros(SIZE)
    x[ACC_BIAS : ACC_BIAS + 3] = bias = (0.1, -0.2, 0.3)
    after = apply_corrections(prediction(estimate), x)
    np.testing.assert_allclose(
        after.force_ned_m_s2, np.subtract(FORCE, rotate(Q, bias)), atol=1e-12
    )


def test_another_imu_has_biases_that_are_not_known(estimate):
    """Both are zero, uncertain as at the beginning, and tied to nothing; the rest stays."""
    params = AidingParams()
    root = np.random.default_rng(5).standard_normal((SIZE, SIZE))
    P = root @ root.T
    learnt = estimate._replace(gyr_bias_rad_s=(0.1, 0.2, 0.3), acc_bias_m_s2=(0.4, 0.5, 0.6))
    state = blank_aiding(params)[0]._replace(estimate=learnt)
    after, Q = forget_biases(params, state, P)
    assert after.estimate == estimate
    biases = slice(GYR_BIAS, ACC_BIAS + 3)
    sigmas = [params.gyr_bias_sigma] * 3 + [params.acc_bias_sigma] * 3
    np.testing.assert_allclose(Q[biases, biases], np.diag(np.square(sigmas)))
    others = np.r_[0:GYR_BIAS, ACC_BIAS + 3 : SIZE]
    assert np.array_equal(Q[np.ix_(others, others)], P[np.ix_(others, others)])
    assert not Q[biases, :][:, others].any()
    assert not Q[others, :][:, biases].any()
