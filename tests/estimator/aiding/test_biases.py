"""A sensor whose one axis is off by more than biases are: the other axes may be, too."""

import numpy as np
import pytest

from estimator.aiding.beginning import blank_aiding
from estimator.aiding.covariance import expected_variance, rotation_matrix
from estimator.aiding.inertial import Prediction, judge_biases
from estimator.aiding.types import ACC_BIAS, GYR_BIAS, SIZE, TURN, AidingParams, BiasPrior
from estimator.aiding.velocity_history import new_velocity_history
from estimator.geometry.quaternion import exp
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3

USUAL = BiasPrior(gyr=0.01**2, acc=0.05**2)
Q = exp((0.3, -0.2, 1.1))


def judged(gyr_bias, acc_bias, *, learnt_axis):
    """Covariances before and after, one axis of either sensor being learnt; and what is usual."""
    P = np.diag(np.linspace(0.02, 0.04, SIZE) ** 2)
    for first, variance in ((GYR_BIAS, USUAL.gyr), (ACC_BIAS, USUAL.acc)):
        for i in range(first, first + 3):
            P[i, i] = variance * (0.01 if i == first + learnt_axis else 1.0)
    estimate = blank_aiding(AidingParams())[0].estimate._replace(
        q_ned_frd=Q, gyr_bias_rad_s=gyr_bias, acc_bias_m_s2=acc_bias
    )
    now = Prediction(estimate, ZERO_VEC3, ZERO_VEC3, new_velocity_history(ZERO_VEC3), P.copy())
    bias_prior = judge_biases(now, USUAL)
    return P, now.covariance, bias_prior


def test_usual_biases_change_nothing():
    before, after, bias_prior = judged((0.009, -0.01, 0.0), (0.0, 0.05, -0.03), learnt_axis=1)
    np.testing.assert_array_equal(before, after)
    assert bias_prior == USUAL


@pytest.mark.parametrize(("first", "usual"), [(GYR_BIAS, USUAL.gyr), (ACC_BIAS, USUAL.acc)])
def test_one_axis_shows_the_others(first, usual):
    """The axis that has been learnt keeps what was learnt."""
    off = 5.0 * usual**0.5
    zero = (0.0, 0.0, 0.0)
    biases = ((0.0, off, 0.0), zero) if first == GYR_BIAS else (zero, (0.0, off, 0.0))
    _, after, bias_prior = judged(*biases, learnt_axis=1)
    assert bias_prior[first == ACC_BIAS] == pytest.approx(off * off)
    diagonal = np.diag(after)[first : first + 3]
    np.testing.assert_allclose(diagonal[[0, 2]], off * off)
    assert diagonal[1] == pytest.approx(1.0 / (99.0 / usual + 1.0 / off**2))


def test_an_accelerometers_bias_has_turned_the_vertical_as_it_seems():
    """So that at rest no velocity contradicts it: R a = turn x f, with f straight up."""
    before, after, _ = judged((0.0, 0.0, 0.0), (0.0, 0.0, 0.4), learnt_axis=2)
    h = np.zeros(SIZE)
    R = rotation_matrix(Q)
    for row, turned in ((0, (TURN + 1, -1.0)), (1, (TURN, 1.0))):
        h[:] = 0.0
        h[turned[0]] = turned[1] * STANDARD_GRAVITY_M_S2
        h[ACC_BIAS : ACC_BIAS + 3] = -R[row]
        assert expected_variance(after, h, 0.0) == pytest.approx(expected_variance(before, h, 0.0))
    assert np.linalg.eigvalsh(after).min() > 0.0
    assert np.diag(after)[TURN] > 1.1 * np.diag(before)[TURN]
