"""Attitudes as curves of angles: what every plot over time draws."""

import numpy as np

from estimator.arrays import Floats
from estimator.geometry.frames import euler_rad


def euler_curves_deg(attitudes: Floats) -> Floats:
    """Roll, pitch, heading in degrees (N, 3) of ``q_ned_frd`` (N, 4), NaN where there is none."""
    angles = [euler_rad((w, x, y, z)) for w, x, y, z in attitudes.tolist()]
    return np.where(np.isnan(attitudes[:, :1]), np.nan, np.degrees(angles).reshape(-1, 3))


def drawn_angles_deg(attitudes: Floats) -> Floats:
    """The same with a gap where one wraps round, so that no line is drawn across."""
    angles = euler_curves_deg(attitudes)
    angles[1:][np.abs(np.diff(angles, axis=0)) > 180.0] = np.nan
    return angles
