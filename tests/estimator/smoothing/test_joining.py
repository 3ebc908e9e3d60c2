"""Two estimates as one: how sure the joint one is."""

import numpy as np
import pytest

from estimator.geometry.rotations import exp, log
from estimator.smoothing.recording import Estimates, joined

ONE_RAD, OTHER_RAD = 0.03, 0.04  # together 0.05


def estimates(heading_rad, sigma_rad, *, is_aided):
    turns = np.array([[0.0, 0.0, heading_rad]])
    return Estimates(exp(turns), np.full((1, 2), sigma_rad), np.array([is_aided]))


def joint(between_rad, *, is_aided):
    """Heading, and sigmas of inclination and heading."""
    one = estimates(0.0, ONE_RAD, is_aided=is_aided)
    both = joined(one, estimates(between_rad, OTHER_RAD, is_aided=is_aided))
    return log(both.q_ned_frd)[0, 2], both.sigma_rad[0]


@pytest.mark.parametrize("is_aided", [False, True])
def test_a_heading_is_the_mean_by_both_variances(is_aided):
    assert joint(0.05, is_aided=is_aided)[0] == pytest.approx(0.05 * 0.36)


@pytest.mark.parametrize(
    ("is_aided", "between_rad", "heading_rad"),
    [
        (True, 0.05, 0.024),  # independent errors: 0.03 * 0.04 / 0.05
        (True, 0.2, 0.096),  # four times further apart than their sigmas are together
        (False, 0.05, 0.0336),  # common errors: the mean, 0.64 * 0.03 + 0.36 * 0.04
        (False, 0.2, 0.096),
    ],
)
def test_sigma_knows_whether_errors_are_common_and_grows_by_what_is_between(
    is_aided, between_rad, heading_rad
):
    inclination, heading = joint(between_rad, is_aided=is_aided)[1]
    assert heading == pytest.approx(heading_rad)
    assert inclination == pytest.approx(0.024 if is_aided else 0.0336)
