"""Frames, Euler angles and angles between attitudes against known ones, scipy and BROAD."""

from math import acos, atan, pi, radians, sqrt

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from estimator.geometry.axes import axes_of, down_of, to_body, to_frame
from estimator.geometry.frames import euler_rad, flu_from_frd, from_euler_rad, swap_ned_enu
from estimator.geometry.metrics import angle_errors, batch_angle_errors, paper_cost
from estimator.geometry.quaternion import exp, multiply, rotate, rotate_inverse
from tests.vocabulary import (
    IDENTITY,
    any_rotation,
    assert_attitude_close,
    floats,
    random_quaternion,
    scipy_rotation,
    unit_vectors,
)

HALF = 0.5**0.5
# (attitude in NED/FRD, the same in ENU/FLU)
KNOWN = {
    # nose north, level: in ENU the x axis (forward) points to +y (north), 90 deg about up
    "north": (IDENTITY, (HALF, 0.0, 0.0, HALF)),
    # nose east, level: ENU's own axes
    "east": ((HALF, 0.0, 0.0, HALF), IDENTITY),
    "west": ((HALF, 0.0, 0.0, -HALF), (0.0, 0.0, 0.0, 1.0)),
    # nose east and 90 deg up (pitch is about the right wing, in FLU about minus left)
    "east, nose up": (from_euler_rad(0.0, pi / 2, pi / 2), (HALF, 0.0, -HALF, 0.0)),
    # nose east, right wing down
    "east, rolled": (from_euler_rad(pi / 2, 0.0, pi / 2), (HALF, HALF, 0.0, 0.0)),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_attitudes(name):
    q_ned_frd, q_enu_flu = KNOWN[name]
    assert_attitude_close(swap_ned_enu(q_ned_frd), q_enu_flu, 1e-14)


@given(any_rotation(), unit_vectors())
def test_attitudes_and_vectors_change_frames_alike(q_ned_frd, v_frd):
    north, east, down = rotate(q_ned_frd, v_frd)
    v_enu = rotate(swap_ned_enu(q_ned_frd), flu_from_frd(v_frd))
    np.testing.assert_allclose(v_enu, (east, north, -down), atol=1e-14)
    assert_attitude_close(swap_ned_enu(swap_ned_enu(q_ned_frd)), q_ned_frd, 1e-14)


@given(floats(-pi, pi), floats(-pi / 2, pi / 2), floats(-pi, pi))
def test_from_euler_agrees_with_scipy(roll, pitch, yaw):
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat(scalar_first=True)
    assert_attitude_close(from_euler_rad(roll, pitch, yaw), tuple(theirs.tolist()), 1e-14)


@given(any_rotation())
def test_euler_angles_describe_the_attitude_and_agree_with_scipy(q):
    """Also next to gimbal lock, where roll is given to yaw, which is off by 0.01 deg at most."""
    roll, pitch, yaw = euler_rad(q)
    assert -pi <= roll <= pi
    assert -pi / 2 <= pitch <= pi / 2
    assert 0.0 <= yaw < 2.0 * pi
    locked = abs(pitch) > radians(89.98)
    again = from_euler_rad(roll, pitch, yaw)
    assert_attitude_close(again, q, radians(0.03) if locked else 1e-9)
    their_yaw, their_pitch, their_roll = scipy_rotation(q).as_euler("ZYX")
    if abs(their_pitch) <= radians(89.9):  # farther from there the angles are unique
        assert pitch == pytest.approx(their_pitch, abs=1e-10)
        for mine, theirs in ((roll, their_roll), (yaw, their_yaw)):
            assert abs((mine - theirs + pi) % (2.0 * pi) - pi) < 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("turn", np.linspace(-3.0, 3.0, 13).tolist())
@pytest.mark.parametrize("roll", [0.0, 0.4, -2.0])
@pytest.mark.parametrize("pitch_deg", [89.0, 89.9, 89.98, 89.995, 89.9999, 90.0])
def test_gimbal_lock(pitch_deg, sign, turn, roll):
    q = from_euler_rad(roll, sign * radians(pitch_deg), turn)
    again = euler_rad(q)
    assert_attitude_close(from_euler_rad(*again), q, radians(0.02) if pitch_deg < 90.0 else 1e-7)
    if pitch_deg == 90.0:
        # the sine of the pitch is 1 to 2e-16, which leaves 2e-8 of angle
        assert again[:2] == (0.0, pytest.approx(sign * pi / 2, abs=1e-7))


@given(any_rotation(), unit_vectors())
def test_there_and_back(q, v):
    axes = axes_of(q)
    assert to_frame(axes, v) == pytest.approx(rotate(q, v), abs=1e-9)
    assert to_body(axes, v) == pytest.approx(rotate_inverse(q, v), abs=1e-9)
    assert down_of(q) == axes.down


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
    errors = angle_errors(multiply(exp((0.0, 0.0, heading)), reference), reference)
    assert errors.heading_rad == pytest.approx(abs(heading), abs=1e-13)
    assert errors.inclination_rad == pytest.approx(0.0, abs=1e-13)
    tilted = multiply(exp((tilt * np.cos(direction), tilt * np.sin(direction), 0.0)), reference)
    errors = angle_errors(tilted, reference)
    assert errors.inclination_rad == pytest.approx(abs(tilt), abs=1e-13)
    assert errors.total_rad == pytest.approx(abs(tilt), abs=1e-13)
    assert errors.heading_rad == pytest.approx(0.0, abs=1e-11)


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
    weights = {0: 0.3, 100: 0.3, 101: 0.0, 399: 0.0, 400: 1.0, 1400: 1.0, 1401: 0.0, 1500: 0.0}
    for k, weight in weights.items():
        e = np.zeros(1501)
        e[k] = 1.0
        assert paper_cost(e) == pytest.approx(weight, abs=1e-15)
    assert paper_cost(np.full(1501, 0.5)) == pytest.approx(0.5 * (0.3 * 101 + 1001))


@pytest.mark.parametrize("shape", [(1500,), (1502,), (0,), (1501, 1)])
def test_cost_refuses_another_experiment(shape):
    with pytest.raises(ValueError, match="1501"):
        paper_cost(np.zeros(shape))
