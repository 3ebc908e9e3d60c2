"""Attitudes of others as quaternions, where they are rotations at all."""

import math

from estimator.geometry.frames import from_euler_rad
from estimator.types import Quaternion

UNIT_NORM_TOLERANCE = 0.05  # quaternions further from unit length are not attitudes


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion | None:
    """q_ned_frd of aerospace angles (yaw, then pitch, then roll), or None if one is not finite."""
    if not (math.isfinite(roll_rad) and math.isfinite(pitch_rad) and math.isfinite(yaw_rad)):
        return None
    return from_euler_rad(roll_rad, pitch_rad, yaw_rad)


def unit_or_none(q: Quaternion) -> Quaternion | None:
    """``q`` at unit length, or None if it is not close to that already (or not finite)."""
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= UNIT_NORM_TOLERANCE:  # also refuses NaN
        return None
    return (w / norm, x / norm, y / norm, z / norm)
