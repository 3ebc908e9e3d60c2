"""Bodies and vectors of the viewer, where no two directions are alike."""

import math

import numpy as np
import pytest

from tests.service.records import record

pytest.importorskip("rerun", reason="the extra viewer is not installed")

from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate, rotate_inverse
from estimator.profile import load_profile
from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample
from fuzzbee.trust import Level
from fuzzbee.viewer.bodies import FIELD_MEAN_S, FieldMean, nose_range, observe_field, vectors
from fuzzbee.viewer.curves import BATCH_S, Curves

Q = from_euler_rad(math.radians(20.0), math.radians(-30.0), math.radians(70.0))
FIELD = (0.2, 0.05, 0.4)
LEARNT = load_profile("imu").reference


def sample(has_mag=True):
    """At rest in that attitude, with the field that lies there."""
    acc = rotate_inverse(Q, (0.0, 0.0, -STANDARD_GRAVITY_M_S2))
    return ImuSample(0, (0.0, 0.0, 0.0), acc, rotate_inverse(Q, FIELD), has_mag)


def test_the_nose_may_be_off_by_the_headings_sigma_sideways_and_by_the_inclinations_upwards():
    points = np.array(nose_range(record(sigma_deg=(5.0, 30.0)), Level.GOOD).points)
    assert np.ptp(points[:, 1]) / 2.0 == pytest.approx(0.8 * math.sin(math.radians(30.0)))
    assert np.ptp(points[:, 2]) / 2.0 == pytest.approx(0.8 * math.sin(math.radians(5.0)))
    np.testing.assert_allclose(points[:, 0], 0.8)


def test_gravity_points_down_and_the_field_where_it_lies():
    size = math.hypot(*FIELD)
    shown = vectors(Q, sample(), LEARNT, FieldMean((0.3, 0.0, 0.4), 1))
    np.testing.assert_allclose(shown.gravity, (0.0, 0.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(shown.field, np.array(FIELD) / 0.5, atol=1e-9)
    np.testing.assert_allclose(shown.field_expected, (0.6, 0.0, 0.8))
    assert math.hypot(*shown.field) == pytest.approx(size / 0.5)


def test_without_a_field_there_is_none_to_be_shown():
    assert vectors(Q, sample(), LEARNT, FieldMean()) == (
        pytest.approx((0.0, 0.0, 1.0), abs=1e-9),
        None,
        None,
    )
    assert vectors(Q, sample(has_mag=False), LEARNT, FieldMean((0.3, 0.0, 0.4), 1)).field is None


def test_the_mean_field_follows_a_reading_by_the_share_of_its_time():
    before = FieldMean((1.0, 0.0, 0.5), 1_000_000)
    now_us = 1_000_000 + round(1e6 * FIELD_MEAN_S)
    assert observe_field(before, (0.0, 2.0, 0.5), now_us).mean_gauss == (0.5, 1.0, 0.5)
    assert observe_field(FieldMean(), rotate(Q, FIELD), 5).at_us == 5


def test_curves_of_several_vehicles_wait_longer_for_their_batch():
    curves = Curves("/1")
    for time_s, vehicles, expected in ((100.0, 1, False), (104.5, 2, False), (104.5, 1, True)):
        curves.begin(time_s)
        assert curves.is_full(vehicles) is expected
    assert BATCH_S < 4.5 < 2 * BATCH_S
