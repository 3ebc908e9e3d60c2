"""What the field's heading teaches, beside a plain Kalman filter of the same model."""

from math import exp, radians, sqrt

import numpy as np
import pytest

from estimator.conditioning.field.magnetic import FieldLook
from estimator.conditioning.field.step import learn_heading
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.state import initial_state
from estimator.conditioning.vertical.bias import predict
from estimator.conditioning.vertical.lowpass import coefficients

PARAMS = ConditioningParams()
OLD_S = 1e5  # of a field: nothing is early any more


def field_of(confidence, age_s, horizontal=0.2, down=0.4):
    field = initial_state(PARAMS).field.magnetic
    reference = field.reference._replace(horizontal=horizontal, down=down, age_s=age_s)
    return field._replace(look=FieldLook(horizontal, down, confidence), reference=reference)


def estimate_of(heading_sigma):
    estimate = initial_state(PARAMS).vertical.estimate
    return estimate._replace(covariance=(*estimate.covariance[:9], heading_sigma**2))


@pytest.mark.parametrize(("lasts_s", "sigma_deg", "expected"), [(0.3, 4.0, 1.0), (1.0, 1.5, 0.48)])
def test_variance_is_that_of_the_errors_of_a_field_that_drifts(lasts_s, sigma_deg, expected):
    """Squared errors over variances, the mean of 100 runs of a minute.

    The field's error is a Gauss-Markov process. The first has the density 2 sigma^2 tau that the
    filter assumes, the second half of it, as good sensors do. The gyroscope drifts as the filter
    expects.
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
        for drift, noise in rng.normal(size=(1200, 2)):
            estimate = predict(PARAMS, k, estimate, (0.0, 0.0, 1.0), 0.0, 0.0)
            truth -= step_s * (bias - estimate.bias_rad_s[2])
            truth += drift * sqrt(k.heading_growth)
            error = left * error + sqrt(1.0 - left * left) * sigma * noise
            off = estimate.heading_rad - truth + error
            estimate = learn_heading(PARAMS, estimate, field, (0.2, 0.2 * off), 1.0, step_s, 0.0)
        ratios.append((estimate.heading_rad - truth) ** 2 / estimate.covariance[9])
    assert np.mean(ratios) == pytest.approx(expected, rel=0.2)
