"""Attitudes as curves of angles: what every plot over time draws."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from estimator.arrays import Floats
from estimator.geometry.frames import euler_rad


def where_known(attitudes: Floats, values: Floats) -> Floats:
    """The values (N, M) with NaN where there is no attitude (N, 4)."""
    return np.where(np.isnan(attitudes[:, :1]), np.nan, values)


def euler_curves_deg(attitudes: Floats) -> Floats:
    """Roll, pitch, heading in degrees (N, 3) of ``q_ned_frd`` (N, 4), NaN where there is none."""
    angles = [euler_rad((q[0], q[1], q[2], q[3])) for q in attitudes.tolist()]
    return where_known(attitudes, np.degrees(angles).reshape(-1, 3))


def draw_angles(
    axes: Any, time_s: Floats, curves: Iterable[tuple[Floats, dict[str, Any], str]]
) -> None:
    """Roll, pitch and heading on three axes: of each curve its attitudes (N, 4), line and label.

    A curve has a gap where it wraps round, so that no line is drawn across.
    """
    for attitudes, line, label in curves:
        angles = euler_curves_deg(attitudes)
        for i, ax in enumerate(axes):
            angle = angles[:, i].copy()
            angle[1:][np.abs(np.diff(angles[:, i])) > 180.0] = np.nan
            ax.plot(time_s, angle, **line, label=label)
    for ax, name in zip(axes, ("roll", "pitch", "heading"), strict=True):
        ax.set_ylabel(f"{name} in °")
