"""Attitudes as curves of angles: what every plot over time draws."""

from collections.abc import Iterable
from typing import Any

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


def draw_angles(
    axes: Any, time_s: Floats, curves: Iterable[tuple[Floats, dict[str, Any], str]]
) -> None:
    """Roll, pitch and heading on three axes: of each curve its attitudes (N, 4), line and label."""
    for attitudes, line, label in curves:
        for ax, angle in zip(axes, drawn_angles_deg(attitudes).T, strict=True):
            ax.plot(time_s, angle, **line, label=label)
    for ax, name in zip(axes, ("roll", "pitch", "heading"), strict=True):
        ax.set_ylabel(f"{name} in °")
