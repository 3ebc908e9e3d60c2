"""Errors by BROAD's formulas written out, and the paper's cost."""

from math import acos, atan, pi, sqrt

import numpy as np
import pytest
from hypothesis import given

from estimator.geometry.metrics import angle_errors, batch_angle_errors, paper_cost
from estimator.geometry.quaternion import exp, multiply
from tests.vocabulary import IDENTITY, any_rotation, floats, random_quaternion, scipy_rotation


@given(any_rotation(), any_rotation())
def test_errors_are_broads(estimate, reference):
    """total = 2 acos|w|, heading = 2 atan|z/w|, inclination = 2 acos sqrt(w^2 + z^2).

    acos of a number next to 1 knows angles only to 2e-8.
    """
    difference = scipy_rotation(estimate) * scipy_rotation(reference).inv()
    w, _, _, z = difference.as_quat(scalar_first=True)
    ours = angle_errors(estimate, reference)
    assert ours.total_rad == pytest.approx(2.0 * acos(min(1.0, abs(w))), abs=1e-7)
    heading = 2.0 * atan(abs(z / w)) if w != 0.0 else pi
    if w * w + z * z > 1e-6:  # upside down there is no heading
        assert ours.heading_rad == pytest.approx(heading, abs=1e-7)
    inclination = 2.0 * acos(min(1.0, sqrt(w * w + z * z)))
    assert ours.inclination_rad == pytest.approx(inclination, abs=1e-7)


@given(any_rotation(), floats(-pi, pi), floats(-3.0, 3.0), floats(-pi, pi))
def test_a_heading_error_is_none_of_inclination(reference, heading, tilt, direction):
    turned = multiply(exp((0.0, 0.0, heading)), reference)
    errors = angle_errors(turned, reference)
    assert errors.heading_rad == pytest.approx(abs(heading), abs=1e-13)
    assert errors.inclination_rad == pytest.approx(0.0, abs=1e-13)
    tilted = multiply(exp((tilt * np.cos(direction), tilt * np.sin(direction), 0.0)), reference)
    errors = angle_errors(tilted, reference)
    assert errors.inclination_rad == pytest.approx(abs(tilt), abs=1e-13)
    assert errors.total_rad == pytest.approx(abs(tilt), abs=1e-13)
    assert errors.heading_rad == pytest.approx(0.0, abs=1e-11)


@given(any_rotation(), any_rotation())
def test_signs_of_quaternions_do_not_matter(estimate, reference):
    opposite = tuple(-x for x in estimate)
    one, other = angle_errors(estimate, reference), angle_errors(opposite, reference)
    assert one == pytest.approx(other, abs=1e-15)
    assert max(one.heading_rad, one.inclination_rad) <= one.total_rad + 1e-12


def test_small_angles_stay_exact():
    for angle in (1e-9, 1e-12, 1e-15):
        errors = angle_errors(exp((angle, 0.0, 0.0)), IDENTITY)
        assert errors.total_rad == pytest.approx(angle, rel=1e-12)
        assert errors.inclination_rad == pytest.approx(angle, rel=1e-12)
        assert errors.heading_rad == 0.0


def test_batch_is_one_by_one():
    rng = np.random.default_rng(40)
    estimate = np.array([random_quaternion(rng) for _ in range(100)])
    reference = np.array([random_quaternion(rng) for _ in range(100)])
    batch = batch_angle_errors(estimate, reference)
    for row, p, q in zip(batch, estimate, reference, strict=True):
        assert tuple(row) == tuple(angle_errors(tuple(p), tuple(q)))
    assert batch_angle_errors(np.empty((0, 4)), np.empty((0, 4))).shape == (0, 3)


def test_cost_counts_both_ends_and_nothing_between():
    """0.3 for k = 0..100 (t = 0..1 s), 1 for k = 400..1400 (t = 4..14 s), at 100 Hz."""
    e = np.zeros(1501)
    for k, weight in (
        *((0, 0.3), (100, 0.3), (101, 0.0), (399, 0.0)),
        *((400, 1.0), (1400, 1.0), (1401, 0.0), (1500, 0.0)),
    ):
        e[:] = 0.0
        e[k] = 1.0
        assert paper_cost(e) == pytest.approx(weight, abs=1e-15)
    assert paper_cost(np.full(1501, 0.5)) == pytest.approx(0.5 * (0.3 * 101 + 1001))


@pytest.mark.parametrize("shape", [(1500,), (1502,), (0,), (1501, 1)])
def test_cost_refuses_another_experiment(shape):
    with pytest.raises(ValueError, match="1501"):
        paper_cost(np.zeros(shape))
