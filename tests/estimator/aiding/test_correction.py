"""Corrections and biases: true value = estimate + error, and what one axis shows of the others."""

import numpy as np
import pytest

from estimator.aiding import types
from estimator.aiding.beginning import Start, begin, blank_aiding, forget_biases
from estimator.aiding.covariance import expected_variance, rotation_matrix
from estimator.aiding.inertial import (
    Prediction,
    apply_corrections,
    judge_biases,
    predict_motion,
    watch_knocks,
)
from estimator.aiding.sources.unaided import level
from estimator.aiding.step import aid
from estimator.aiding.types import (
    ACC_BIAS,
    GYR_BIAS,
    HARD_IRON,
    SIZE,
    TURN,
    AidingParams,
    BiasPrior,
)
from estimator.aiding.unseen import watch_turning
from estimator.aiding.velocity_history import new_velocity_history
from estimator.geometry.quaternion import exp, multiply, rotate
from estimator.types import IDENTITY, NO_SAMPLE, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Sample
from tests.vocabulary import assert_attitude_close

Q = exp((0.4, -0.9, 1.3))
FORCE = (1.0, 2.0, -9.0)


BLANK, _, HISTORY = blank_aiding(AidingParams())


def corrected(at=0, *error):
    """What these errors, of which the first is the one ``at``, make of a prediction."""
    estimate = BLANK.estimate._replace(q_ned_frd=Q, velocity_ned_m_s=(5.0, -3.0, 1.0))
    history, x = new_velocity_history(ZERO_VEC3), np.zeros(SIZE)
    x[at : at + len(error)] = error
    now = Prediction(estimate, FORCE, ZERO_VEC3, history, np.zeros((SIZE, SIZE)))
    return apply_corrections(now, x)


def numbers(estimate):
    """Everything but the attitude and what nobody learns, in the order of the errors."""
    parts = [np.atleast_1d(np.asarray(part)) for part in estimate[1:-1]]
    return np.concatenate(parts)


@pytest.mark.parametrize("error", range(3, SIZE))
def test_each_error_corrects_its_own_number_and_no_other(error):
    """The estimate's fields are in the order of the errors, which begin with the turn."""
    before, after = corrected().estimate, corrected(error, 0.01).estimate
    assert after.q_ned_frd == before.q_ned_frd
    expected = np.zeros(SIZE - 3)
    expected[error - 3] = 0.01
    np.testing.assert_allclose(numbers(after) - numbers(before), expected, atol=1e-15)


def test_a_turn_is_about_the_axes_of_ned_and_takes_the_force_along():
    turn, bias = (0.02, -0.01, 0.03), (0.1, -0.2, 0.3)
    after = corrected(TURN, *turn)
    assert_attitude_close(after.estimate.q_ned_frd, multiply(exp(turn), Q), 1e-12)
    np.testing.assert_allclose(after.force_ned_m_s2, rotate(exp(turn), FORCE), atol=1e-12)
    felt = np.subtract(FORCE, rotate(Q, bias))  # a bias of the accelerometer comes off it
    np.testing.assert_allclose(corrected(ACC_BIAS, *bias).force_ned_m_s2, felt, atol=1e-12)


def test_the_beginning_is_as_uncertain_as_given():
    """About north and east by the tilt's sigma, about down by the heading's."""
    first = Start(IDENTITY, 0.3, 0.1, hard_iron_sigma_gauss=0.02, field_lag_s=0.05)
    _, P, _ = begin(AidingParams(), first, NO_SAMPLE, types.NO_REPORT)
    assert np.diag(P)[:3] == pytest.approx([0.01, 0.01, 0.09])
    assert np.diag(P)[HARD_IRON : HARD_IRON + 3] == pytest.approx([0.0004] * 3)
    assert np.array_equal(P, np.diag(np.diag(P)))


def test_iron_explains_no_more_than_the_headings_error():
    """45 deg are the most of a heading's sigma; 0.3 gauss of iron would turn it by more."""
    first = Start(IDENTITY, 0.8, 0.1, 0.1, (3.0, 4.0, 0.0), hard_iron_sigma_gauss=0.3)
    _, P, _ = begin(AidingParams(), first, NO_SAMPLE, types.NO_REPORT)
    assert np.linalg.eigvalsh(P)[0] > -1e-12
    assert P[TURN + 2, HARD_IRON : HARD_IRON + 3] == pytest.approx([0.144, 0.192, 0.0])


def test_another_imu_has_biases_that_are_not_known():
    """Both are zero, uncertain as at the beginning, and tied to nothing; the rest stays."""
    params = AidingParams()
    root = np.random.default_rng(5).standard_normal((SIZE, SIZE))
    P = root @ root.T
    biased = {"gyr_bias_rad_s": (0.1, 0.2, 0.3), "acc_bias_m_s2": (0.4, 0.5, 0.6)}
    learnt = BLANK._replace(estimate=BLANK.estimate._replace(**biased))
    after, Q = forget_biases(params, learnt, P)
    assert after.estimate == BLANK.estimate
    biases = slice(GYR_BIAS, ACC_BIAS + 3)
    sigmas = [params.gyr_bias_sigma] * 3 + [params.acc_bias_sigma] * 3
    np.testing.assert_allclose(Q[biases, biases], np.diag(np.square(sigmas)))
    others = np.r_[0:GYR_BIAS, ACC_BIAS + 3 : SIZE]
    assert np.array_equal(Q[np.ix_(others, others)], P[np.ix_(others, others)])
    assert not Q[biases, :][:, others].any()
    assert not Q[others, :][:, biases].any()


USUAL = BiasPrior(gyr=0.01**2, acc=0.05**2)
ATTITUDE = exp((0.3, -0.2, 1.1))


def judged(gyr_bias, acc_bias, *, learnt_axis):
    """Covariances before and after, one axis of either sensor being learnt; and what is usual."""
    P = np.diag(np.linspace(0.02, 0.04, SIZE) ** 2)
    for first, variance in ((GYR_BIAS, USUAL.gyr), (ACC_BIAS, USUAL.acc)):
        for i in range(first, first + 3):
            P[i, i] = variance * (0.01 if i == first + learnt_axis else 1.0)
    biased = {"gyr_bias_rad_s": gyr_bias, "acc_bias_m_s2": acc_bias}
    estimate = BLANK.estimate._replace(q_ned_frd=ATTITUDE, **biased)
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
    R = rotation_matrix(ATTITUDE)
    for row, turned in ((0, (TURN + 1, -1.0)), (1, (TURN, 1.0))):
        h[:] = 0.0
        h[turned[0]] = turned[1] * STANDARD_GRAVITY_M_S2
        h[ACC_BIAS : ACC_BIAS + 3] = -R[row]
        assert expected_variance(after, h, 0.0) == pytest.approx(expected_variance(before, h, 0.0))
    assert np.linalg.eigvalsh(after).min() > 0.0
    assert np.diag(after)[TURN] > 1.1 * np.diag(before)[TURN]


@pytest.mark.parametrize(
    ("dt_s", "wait_s", "push_m_s2"),
    [(0.5, 0.0, 1.0), (0.5, 3.0, 0.0), (0.02, 3.0, 3.0)],  # reported, not counted, felt
)
def test_a_step_that_is_slow_or_without_reports_is_corrected_once(dt_s, wait_s, push_m_s2):
    """The unaided gravity corrects it; there is no report and no field."""
    params, gravity_b = AidingParams(), (0.1, -0.2, 0.97)
    others = types.StepInputs(gravity_b, 0.1, 0.0, types.North(False, (1.0, 0.0)))
    sample = Sample((0.1, 0.2, -0.1), (0.5, -0.3, -9.7), ZERO_VEC3, False, dt_s)
    root = np.eye(SIZE) + 0.1 * np.random.default_rng(3).standard_normal((SIZE, SIZE))
    P = 0.01 * root @ root.T
    agreement = types.Agreements(*(each._replace(wait_s=wait_s) for each in BLANK.agreement))
    acceleration_tilt = types.AccelerationTilt((3.0, 0.0, 0.0), (1.0, 1.0, 9.0), (2.5, 3.0, 0.0))
    state = BLANK._replace(agreement=agreement, acceleration_tilt=acceleration_tilt)
    after, after_P, _ = aid(params, state, P, HISTORY, sample, types.NO_REPORT, others)
    now = predict_motion(params, state, P, HISTORY, sample)
    rough = watch_knocks(now.covariance, state.rough, now.velocity_history, dt_s)
    if dt_s == 0.5:
        watch_turning(params, state.last, rough, now.covariance, sample, 0.0)
    tilt_error_rad = push_m_s2 / STANDARD_GRAVITY_M_S2
    now, cusum = level(now, state.correction_cusum, others, tilt_error_rad, 1.0, dt_s)
    assert np.abs(cusum.turn_rad).max() > 1e-4
    assert after.estimate == now.estimate
    assert np.array_equal(after_P, now.covariance)
