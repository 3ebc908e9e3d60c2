"""The only file where frames change: NED/FRD to ENU/FLU (ROS REP 103); Euler angles for display.

ENU from NED is half a turn about (1, 1, 0)/sqrt 2 (swap x and y, negate z), FLU from FRD half a
turn about x (negate y and z). Each is its own inverse.
"""

from math import asin, atan2, cos, pi, radians, sin, sqrt

from estimator.compilation.compiled import inlined
from estimator.geometry.quaternion import multiply, normalize
from estimator.types import Quaternion, Vec3

Q_ENU_NED: Quaternion = (0.0, sqrt(0.5), sqrt(0.5), 0.0)
Q_FRD_FLU: Quaternion = (0.0, 1.0, 0.0, 0.0)

# Sine of the pitch (89.99 deg) beyond which roll and yaw cannot be separated.
GIMBAL_LOCK_SINE = sin(radians(89.99))


def swap_ned_enu(q: Quaternion) -> Quaternion:
    """Attitude as ROS has it, or back: ``q_enu_flu = q_enu_ned q_ned_frd q_frd_flu``."""
    return normalize(multiply(multiply(Q_ENU_NED, q), Q_FRD_FLU))


def flu_from_frd(v_frd: Vec3) -> Vec3:
    """Body vector FRD to FLU, or back."""
    return (v_frd[0], -v_frd[1], -v_frd[2])


@inlined
def euler_rad(q_ned_frd: Quaternion) -> Vec3:
    """Roll, pitch, yaw (rad) of the yaw-pitch-roll (ZYX) sequence, for display; yaw in [0, 2 pi).

    At pitch +-90 deg roll and yaw are not unique; the pair still describes the attitude.
    """
    w, x, y, z = q_ned_frd
    sine = 2.0 * (w * y - z * x)
    pitch = asin(max(-1.0, min(1.0, sine)))
    if abs(sine) > GIMBAL_LOCK_SINE:
        # roll and yaw turn about one axis: give it all to yaw
        roll = 0.0
        yaw = -2.0 * atan2(x, w) if sine > 0.0 else 2.0 * atan2(x, w)
    else:
        roll = atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        yaw = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    yaw %= 2.0 * pi
    return (roll, pitch, 0.0 if yaw >= 2.0 * pi else yaw)


def from_euler_rad(roll: float, pitch: float, yaw: float) -> Quaternion:
    """``q_ned_frd`` of the yaw-pitch-roll (ZYX) angles in rad, as MAVLink's ATTITUDE sends them."""
    cr, sr = cos(0.5 * roll), sin(0.5 * roll)
    cp, sp = cos(0.5 * pitch), sin(0.5 * pitch)
    cy, sy = cos(0.5 * yaw), sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
