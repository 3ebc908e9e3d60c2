"""When the vehicle moved, judged by its raw IMU samples and not by any estimate."""

from typing import Any

import numpy as np

from drivers.logs.table import blocks
from estimator.types import Bools, Floats, Ints

# At rest the gyroscope and the accelerometer stay this near their medians over the window.
REST_GYR_RAD_S = np.radians(2.0)
REST_ACC_M_S2 = 0.3
MOST_BIAS_RAD_S = np.radians(4.0)  # a steady rate above that of any gyroscope's bias is a turn
WINDOW_S = 1.5  # before a sample, and again behind it
MARGIN_US = 1_501_000
BELOW, ABOVE = 1.0 - 1e-9, 1.0 + 1e-9  # so near a limit the medians themselves decide


def motion_mask(columns: Any) -> Bools:
    """(N,): whether anything moved within ``WINDOW_S`` of each of the samples in the columns."""
    times_us = columns["time_us"]
    moved = np.zeros(len(times_us), np.bool_)
    for rows in blocks(len(times_us)):
        now_us = times_us[rows]
        reach_us = [now_us[0] - MARGIN_US, now_us[-1] + MARGIN_US]
        around = slice(*np.searchsorted(times_us, reach_us).tolist())
        times_s, now_s = 1e-6 * times_us[around], 1e-6 * now_us
        first = np.searchsorted(times_s, now_s - WINDOW_S)
        behind = np.searchsorted(times_s, now_s + WINDOW_S, side="right")
        gyr, acc = columns["gyr_rad_s"][around], columns["acc_m_s2"][around]
        readings = np.stack([gyr / REST_GYR_RAD_S, acc / REST_ACC_M_S2], axis=1)
        moved[rows] = _moved(readings, first, behind)
    return moved


def _moved(readings: Floats, first: Ints, behind: Ints) -> Bools:
    """Whether anything moved from rows ``first`` (N,) up to ``behind`` (N,).

    Readings (M, 2, 3) are in units of what each sensor may leave its median by. Medians take long,
    and lie between the least and the largest reading: where that decides they are not taken.
    """
    ends = np.column_stack([first, behind]).ravel()
    columns = np.ascontiguousarray(readings.T)  # of which each window lies in one piece
    columns = np.pad(columns, ((0, 0), (0, 0), (0, 1)))  # where the last one ends
    low, high = (of.reduceat(columns, ends, axis=2)[..., ::2].T for of in (np.minimum, np.maximum))
    width, bias = high - low, MOST_BIAS_RAD_S / REST_GYR_RAD_S
    least, largest = np.maximum(0.0, np.maximum(low, -high)), np.maximum(-low, high)
    moved: Bools = (0.5 * width.max(axis=2, initial=0.0) > ABOVE).any(axis=1)
    moved |= np.linalg.norm(least[:, 0], axis=1) > bias * ABOVE
    rested = (np.linalg.norm(width, axis=2) < BELOW).all(axis=1)
    rested &= np.linalg.norm(largest[:, 0], axis=1) < bias * BELOW
    for k in np.flatnonzero(~moved & ~rested).tolist():
        window = readings[first[k] : behind[k]]
        middle = np.median(window, axis=0)
        moved[k] = np.linalg.norm(window - middle, axis=2).max() >= 1.0
        moved[k] |= np.linalg.norm(middle[0]) > bias
    return moved
