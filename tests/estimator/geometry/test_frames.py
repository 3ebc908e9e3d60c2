"""Frames and Euler angles against known attitudes and scipy."""

from math import pi, radians

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from estimator.geometry.axes import axes_of, down_of, to_body, to_frame
from estimator.geometry.frames import euler_rad, flu_from_frd, from_euler_rad, swap_ned_enu
from estimator.geometry.quaternion import rotate, rotate_inverse
from tests.vocabulary import (
    IDENTITY,
    any_rotation,
    assert_attitude_close,
    floats,
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
    assert_attitude_close(swap_ned_enu(q_enu_flu), q_ned_frd, 1e-14)


@given(any_rotation(), unit_vectors())
def test_attitudes_and_vectors_change_frames_alike(q_ned_frd, v_frd):
    """Rotating and then changing the frame is changing the frame and then rotating."""
    north, east, down = rotate(q_ned_frd, v_frd)
    v_enu = rotate(swap_ned_enu(q_ned_frd), flu_from_frd(v_frd))
    np.testing.assert_allclose(v_enu, (east, north, -down), atol=1e-14)
    assert_attitude_close(swap_ned_enu(swap_ned_enu(q_ned_frd)), q_ned_frd, 1e-14)


@given(floats(-pi, pi), floats(-pi / 2, pi / 2), floats(-pi, pi))
def test_from_euler_agrees_with_scipy(roll, pitch, yaw):
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat(scalar_first=True)
    assert_attitude_close(from_euler_rad(roll, pitch, yaw), tuple(theirs.tolist()), 1e-14)


@given(any_rotation())
def test_euler_angles_describe_the_attitude(q):
    """Also next to gimbal lock, where roll and yaw are not unique but their combination is.

    Within 89.99 deg of pitch roll is given to yaw, which is off by at most that 0.01 deg.
    """
    roll, pitch, yaw = euler_rad(q)
    assert -pi <= roll <= pi
    assert -pi / 2 <= pitch <= pi / 2
    assert 0.0 <= yaw < 2.0 * pi
    locked = abs(pitch) > radians(89.98)
    again = from_euler_rad(roll, pitch, yaw)
    assert_attitude_close(again, q, radians(0.03) if locked else 1e-9)


@given(any_rotation())
def test_euler_agrees_with_scipy(q):
    yaw, pitch, roll = scipy_rotation(q).as_euler("ZYX")
    if abs(pitch) > radians(89.9):
        return
    ours = euler_rad(q)
    # away from gimbal lock the angles are unique; sin(pitch) loses digits as it nears 1
    assert ours[1] == pytest.approx(pitch, abs=1e-10)
    for mine, other in ((ours[0], roll), (ours[2], yaw)):
        assert abs((mine - other + pi) % (2.0 * pi) - pi) < 1e-9


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


def test_yaw_starts_again_at_north():
    assert euler_rad(from_euler_rad(0.0, 0.0, -1e-18))[2] < 2.0 * pi
    assert euler_rad(from_euler_rad(0.0, 0.0, -0.1))[2] == pytest.approx(2.0 * pi - 0.1)
    assert euler_rad((-1.0, 0.0, 0.0, 0.0)) == pytest.approx((0.0, 0.0, 0.0))


@given(any_rotation(), unit_vectors())
def test_there_and_back(q, v):
    axes = axes_of(q)
    assert to_frame(axes, v) == pytest.approx(rotate(q, v), abs=1e-9)
    assert to_body(axes, v) == pytest.approx(rotate_inverse(q, v), abs=1e-9)
    assert down_of(q) == axes.down
