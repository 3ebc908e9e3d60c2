"""What the field's heading teaches, beside a plain Kalman filter of the same model."""

from math import exp, radians, sqrt

import numpy as np
import pytest

from estimator.conditioning import initial_state
from estimator.conditioning.field.magnetic import FieldLook
from estimator.conditioning.field.step import heading_noise, learn_heading
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.robust import HEADING_REACH_RAD
from estimator.conditioning.times import MEMORY_S, USUAL_S
from estimator.conditioning.vertical.bias import predict
from estimator.conditioning.vertical.lowpass import coefficients

PARAMS = ConditioningParams()
DT = 0.01
OLD_S = 1e5  # of a field: nothing is early any more
ROWS = ((0, 0), (0, 1), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (2, 2), (2, 3), (3, 3))


def field_of(confidence, age_s, horizontal=0.2, down=0.4):
    field = initial_state(PARAMS).field.magnetic
    reference = field.reference._replace(horizontal=horizontal, down=down, age_s=age_s)
    return field._replace(look=FieldLook(horizontal, down, confidence), reference=reference)


def square(packed):
    p = np.zeros((4, 4))
    for (i, j), value in zip(ROWS, packed, strict=True):
        p[i, j] = p[j, i] = value
    return p


def estimate_of(heading_sigma):
    estimate = initial_state(PARAMS).vertical.estimate
    return estimate._replace(covariance=(*estimate.covariance[:9], heading_sigma**2))


@pytest.mark.parametrize("confidence", [0.3, 1.0])
def test_noise_is_larger_for_a_new_field_and_a_doubtful_one(confidence):
    new, later, old = (heading_noise(PARAMS, field_of(confidence, s), 1.0) for s in (0, 20, OLD_S))
    doubtful = PARAMS.heading_doubt_noise_rad2_s * (1.0 / confidence - 1.0)
    assert new > later > old
    assert old - doubtful == pytest.approx(PARAMS.heading_noise_rad2_s, rel=1e-3)
    # a tilted vertical, as of a start, turns the field as a magnet does
    assert heading_noise(PARAMS, field_of(confidence, OLD_S), 0.1) > old


def test_learning_is_a_kalman_filter_of_bias_and_heading():
    """Ten seconds of a turning body; the plain filter has matrices and no packed covariance."""
    rng = np.random.default_rng(3)
    k = coefficients(PARAMS, DT, 1.0)
    estimate = estimate_of(0.3)
    x, p = np.zeros(4), square(estimate.covariance)
    field = field_of(0.8, OLD_S)
    for i in range(1000):
        down = np.array([np.sin(0.01 * i), 0.3, np.cos(0.01 * i)])
        down /= np.linalg.norm(down)
        f = np.eye(4)
        f[3, :3] = -DT * down
        growth = PARAMS.bias_motion_sigma_rad_s**2 * DT / 100.0
        growths = [growth * (p[n, n] < PARAMS.bias_initial_sigma_rad_s**2) for n in range(3)]
        q = PARAMS.heading_noise_rad2_s * DT / USUAL_S**2
        p = f @ p @ f.T + np.diag([*growths, q + PARAMS.heading_turning_noise_s * 0.5 * DT])
        estimate = predict(PARAMS, k, estimate, tuple(down), 0.5, 0.0)
        residual = rng.normal(0.02, 0.05)
        r = PARAMS.heading_noise_rad2_s * (1.0 + MEMORY_S / (1.0 + OLD_S))
        r = (r + PARAMS.heading_doubt_noise_rad2_s * (1.0 / 0.8 - 1.0)) / DT
        r *= (1.0 + residual**2 / (HEADING_REACH_RAD**2 + 9.0 * p[3, 3])) ** 2
        gain = p[:, 3] / (p[3, 3] + r)
        x -= gain * residual
        p -= np.outer(gain, p[3])
        horizontal = (field.reference.horizontal, residual * field.reference.horizontal)
        estimate = learn_heading(PARAMS, estimate, field, horizontal, 1.0, DT, 0.0)
    assert (*estimate.bias_rad_s, estimate.heading_rad) == pytest.approx(x, rel=1e-9)
    assert square(estimate.covariance) == pytest.approx(p, rel=1e-9, abs=1e-18)


@pytest.mark.parametrize(("lasts_s", "sigma_deg", "expected"), [(0.3, 4.0, 1.0), (1.0, 1.5, 0.48)])
def test_variance_is_that_of_the_errors_of_a_field_that_wanders(lasts_s, sigma_deg, expected):
    """Squared errors over variances, the mean of 100 runs of a minute.

    The field's error is a Gauss-Markov process. The first has the density 2 sigma^2 tau that the
    filter takes the error for, so its variance is honest. The second is as measured under optical
    truth on the better sensors, of half that density. The gyroscope drifts as the filter expects.
    """
    rng = np.random.default_rng(7)
    step_s = 0.05
    k = coefficients(PARAMS, step_s, 1.0)
    field = field_of(1.0, OLD_S)
    sigma, left = radians(sigma_deg), exp(-step_s / lasts_s)
    ratios = []
    for _ in range(100):
        estimate = estimate_of(radians(5.0))
        truth, bias = rng.normal(0.0, radians(5.0)), rng.normal(0.0, radians(0.5))
        error = rng.normal(0.0, sigma)
        for drift, force_scatter in rng.normal(size=(1200, 2)):
            estimate = predict(PARAMS, k, estimate, (0.0, 0.0, 1.0), 0.0, 0.0)
            truth -= step_s * (bias - estimate.bias_rad_s[2])
            truth += drift * sqrt(k.heading_growth)
            error = left * error + sqrt(1.0 - left * left) * sigma * force_scatter
            off = estimate.heading_rad - truth + error
            estimate = learn_heading(PARAMS, estimate, field, (0.2, 0.2 * off), 1.0, step_s, 0.0)
        ratios.append((estimate.heading_rad - truth) ** 2 / estimate.covariance[9])
    assert np.mean(ratios) == pytest.approx(expected, rel=0.2)
