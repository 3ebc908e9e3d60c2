"""A force that asks for a turn of the attitude which gyroscope and field do not show."""

from math import radians

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.aiding.force_fault import Before, follow_field, is_no_turn
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, rotate_inverse, unit
from estimator.profile import load_profile, merge_profile
from tests.flight import HEADING, INCLINATION, TRUE_NORTH, banked_flight, changed, errors_deg, flown

DT = 0.02
DOWN_AND_NORTH = unit((0.22, 0.0, 0.42))
Q_NED_G = exp((0.3, -0.2, 2.0))
NORTH, EAST = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def seen_before():
    """What is known of a field that has stood still in G for a while."""
    before = Before()
    for _ in range(200):
        before = follow_field(before, rotate_inverse(Q_NED_G, DOWN_AND_NORTH), DT)
    return before


def field_after(turn_rad):
    """The field in G after a turn (NED) that the gyroscope has missed."""
    turned = Rotation.from_rotvec(turn_rad).inv().apply(DOWN_AND_NORTH)
    return rotate_inverse(Q_NED_G, tuple(turned))


@pytest.mark.parametrize("axis", [NORTH, EAST], ids=["north", "east"])
@pytest.mark.parametrize("angle_deg", [-10.0, 5.0, 15.0])
def test_a_turn_that_was_made_turns_the_field_in_g(axis, angle_deg):
    """A field that stands still shows that it was not made, however it was asked for."""
    turn_rad = tuple(radians(angle_deg) * a for a in axis)
    before, made = seen_before(), field_after(turn_rad)
    assert not is_no_turn(before, made, Q_NED_G, turn_rad)
    still = rotate_inverse(Q_NED_G, DOWN_AND_NORTH)
    assert is_no_turn(before, still, Q_NED_G, turn_rad)
    half = field_after(tuple(0.5 * t for t in turn_rad))
    assert not is_no_turn(before, half, Q_NED_G, turn_rad)


def test_a_field_shows_nothing_of_a_turn_about_it_nor_before_it_was_seen():
    turn_rad = tuple(radians(15.0) * a for a in DOWN_AND_NORTH)
    still = rotate_inverse(Q_NED_G, DOWN_AND_NORTH)
    assert not is_no_turn(seen_before(), still, Q_NED_G, turn_rad)
    assert not is_no_turn(Before(), still, Q_NED_G, (radians(15.0), 0.0, 0.0))


@pytest.mark.parametrize("axis", range(3))
def test_an_accelerometer_that_steps_leaves_the_attitude_alone(axis):
    """By 3 m/s^2, which is 17 deg of tilt, for 20 s of banked turns."""

    def step(sample, _):
        force = np.array(sample.acc_m_s2)
        force[axis] += 3.0 * (20e6 < sample.time_us < 40e6)
        return sample._replace(acc_m_s2=tuple(force.tolist()))

    flight = changed(banked_flight(), step)
    attitudes = flown(Estimator(merge_profile(load_profile("imu"), TRUE_NORTH)), flight)
    errors = errors_deg(flight, attitudes)
    times_s = np.array([s.time_us for s in flight.samples]) * 1e-6
    sigma_deg = np.degrees([(a.sigma_heading_rad, a.sigma_inclination_rad) for a in attitudes])
    found = times_s > 24.0
    assert errors[found, INCLINATION].max() < 4.5
    assert errors[found, HEADING].max() < 4.0
    for error, sigma in zip(errors[:, [HEADING, INCLINATION]].T, sigma_deg.T, strict=True):
        assert np.mean(error[times_s > 20.0] > 3.0 * sigma[times_s > 20.0]) < 0.05
