"""Readings and reports as rows: what a batch of the array estimator is made of."""

from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from estimator.aiding.sources.source import SPEED_LIMIT_M_S
from estimator.arrays import Floats, Times
from estimator.errors import InputError
from estimator.live.rows import HAS_VERTICAL, REPORT_SIZE, ROW, SIGMA_M_S, TIME, Rows, X, Z
from fuzzbee.arguments import MOST_S, matrix

# Of a satellite receiver's or an autopilot's velocity, unless another sigma is given.
VELOCITY_SIGMA_M_S = 0.3
# Latitude, longitude (deg), altitude (m), Unix time (s).
MOST_PLACE = (90.0, 360.0, inf, MOST_S)


class Batch(NamedTuple):
    """Rows of readings, and of velocities (M, REPORT_SIZE) as :mod:`estimator.live.rows` has them.

    ``positions`` (K, 5) come before the rows that they name: row, latitude, longitude (deg),
    altitude (m), Unix time (s). ``warnings`` are those of :mod:`fuzzbee.fit`.
    """

    rows: Rows
    velocities: Floats
    positions: Floats
    warnings: tuple[str, ...]


def velocities_of(times_us: Times, velocity: Floats) -> tuple[Floats, int]:
    """Reports (M, REPORT_SIZE) of velocities (N, 3); how many are too fast and left out.

    NaN is unknown; only the third component may be unknown in a report.
    """
    known = np.flatnonzero(np.isfinite(velocity[:, :2]).all(axis=1))
    reports = np.zeros((len(known), REPORT_SIZE))
    reports[:, ROW], reports[:, TIME] = known, times_us[known]
    reports[:, X : Z + 1], reports[:, SIGMA_M_S] = velocity[known], VELOCITY_SIGMA_M_S
    reports[:, HAS_VERTICAL] = np.isfinite(reports[:, Z])
    reports[reports[:, HAS_VERTICAL] == 0.0, Z] = 0.0
    is_fast = np.abs(reports[:, X : Z + 1]).max(axis=1, initial=0.0) > SPEED_LIMIT_M_S
    return reports[~is_fast], int(is_fast.sum())


def positions_of(position: ArrayLike, n: int) -> Floats:
    """The rows (K, 5) of positions (N, 4) that are known, behind their numbers."""
    places = matrix("position", position, n, 4)
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    wrong = known[(np.abs(places[known]) > MOST_PLACE).any(axis=1)]
    if len(wrong):
        place = places[wrong[0]].tolist()
        raise InputError(f"position {place}: no place on Earth, or no time")
    return np.column_stack((known, places[known]))
