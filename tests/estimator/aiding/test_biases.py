"""A sensor whose one axis is off by more than biases are: the other axes may be, too."""

import numpy as np
import pytest

from estimator.aiding import blank_aiding
from estimator.aiding.covariance import learn, rotation_matrix
from estimator.aiding.inertial import Prediction, judge_biases
from estimator.aiding.trail import new_trail
from estimator.aiding.types import ACC_BIAS, GYR_BIAS, SIZE, TURN, AidingParams, Unlearnt
from estimator.geometry.quaternion import exp
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3

PARAMS = AidingParams()
USUAL = Unlearnt(gyr=PARAMS.gyr_bias_sigma**2, acc=PARAMS.acc_bias_sigma**2)
Q = exp((0.3, -0.2, 1.1))
NOISE = 1e-4  # (m/s^2)^2


def rested(unlearnt):
    """The covariance after a rest that shows tilt and accelerometer's bias together."""
    P = np.diag(np.linspace(0.02, 0.04, SIZE) ** 2)
    for first, variance in ((GYR_BIAS, unlearnt.gyr), (ACC_BIAS, unlearnt.acc)):
        for i in range(first, first + 3):
            P[i, i] = variance
    R = rotation_matrix(Q)
    for k in range(3):  # no velocity has come of what is felt: turn x f - R a, f straight up
        h = np.zeros(SIZE)
        h[ACC_BIAS : ACC_BIAS + 3] = -R[k]
        if k < 2:
            h[TURN + 1 - k] = (-1.0, 1.0)[k] * STANDARD_GRAVITY_M_S2
        learn(P, np.zeros(SIZE), h, 0.0, NOISE)
    return P


def judged(P, gyr_bias, acc_bias):
    estimate = blank_aiding(PARAMS)[0].estimate._replace(
        q_ned_frd=Q, gyr_bias_rad_s=gyr_bias, acc_bias_m_s2=acc_bias
    )
    now = Prediction(estimate, ZERO_VEC3, ZERO_VEC3, new_trail(ZERO_VEC3), P.copy())
    return judge_biases(PARAMS, now, USUAL), now.covariance


def test_usual_biases_change_nothing():
    P = rested(USUAL)
    unlearnt, after = judged(P, (0.009, -0.01, 0.0), (0.03, -0.05, 0.03))
    np.testing.assert_array_equal(after, P)
    assert unlearnt == USUAL


@pytest.mark.parametrize(
    ("gyr_bias", "acc_bias", "expected"),
    [
        (ZERO_VEC3, (0.0, 0.0, -0.3), Unlearnt(USUAL.gyr, 0.3**2)),
        ((0.0, 0.06, 0.0), ZERO_VEC3, Unlearnt(0.06**2, 0.3**2)),
    ],
    ids=["accelerometer", "gyroscope"],
)
def test_what_was_learnt_counts_as_if_the_sensor_had_been_taken_for_that_poor(
    gyr_bias, acc_bias, expected
):
    """One axis tells of the others, and a gyroscope that nobody has calibrated of both sensors."""
    unlearnt, after = judged(rested(USUAL), gyr_bias, acc_bias)
    assert unlearnt == pytest.approx(expected)
    np.testing.assert_allclose(after, rested(expected), rtol=1e-6, atol=1e-12)
    assert np.linalg.eigvalsh(after).min() > 0.0
