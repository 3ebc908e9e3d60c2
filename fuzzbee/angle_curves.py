"""Attitudes as curves of angles: what every plot over time draws."""

import numpy as np
from numpy.typing import NDArray

from estimator.geometry.frames import euler_rad

Floats = NDArray[np.float64]


def euler_curves_deg(attitudes: Floats) -> Floats:
    """Roll, pitch and yaw in degrees (N, 3) of ``q_ned_frd`` (N, 4); N may be 0."""
    angles = [euler_rad((q[0], q[1], q[2], q[3])) for q in attitudes.tolist()]
    return np.degrees(angles).reshape(-1, 3)


def cut_at_wraps(angle_deg: Floats) -> Floats:
    """The curve (N,) with a gap where it wraps round, so that no line is drawn across."""
    cut = angle_deg.copy()
    cut[1:][np.abs(np.diff(angle_deg)) > 180.0] = np.nan
    return cut
