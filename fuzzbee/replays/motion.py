"""When the vehicle moved, judged by its raw IMU samples and not by any estimate."""

from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats, Ints

# At rest the gyroscope and the accelerometer stay this near their medians over the window.
REST_GYR_RAD_S = np.radians(2.0)
REST_ACC_M_S2 = 0.3
# A steady rate above this is a turn: the bias of a gyroscope is smaller.
MOST_BIAS_RAD_S = np.radians(4.0)
WINDOW_S = 1.5  # before a sample, and again behind it
MARGIN_US = 1_501_000
# What lies so near a limit is decided by the medians themselves.
ROUNDING = 1e-9
# Samples that are judged together: a block's numbers stay in the processor's caches.
BLOCK = 20_000


class Windows(NamedTuple):
    """Rows from ``first`` (N,) up to ``behind`` (N,)."""

    first: Ints
    behind: Ints


def motion_mask(columns: Any) -> Bools:
    """(N,): whether anything moved within ``WINDOW_S`` of each of the samples in the columns."""
    times_us = columns["time_us"]
    moved = np.zeros(len(times_us), np.bool_)
    for begin in range(0, len(times_us), BLOCK):
        now_us = times_us[begin : begin + BLOCK]
        reach_us = [now_us[0] - MARGIN_US, now_us[-1] + MARGIN_US]
        around = slice(*np.searchsorted(times_us, reach_us).tolist())
        times_s, now_s = 1e-6 * times_us[around], 1e-6 * now_us
        windows = Windows(
            np.searchsorted(times_s, now_s - WINDOW_S),
            np.searchsorted(times_s, now_s + WINDOW_S, side="right"),
        )
        gyr, acc = columns["gyr_rad_s"][around], columns["acc_m_s2"][around]
        moved[begin : begin + BLOCK] = _moved(gyr, acc, windows)
    return moved


def _moved(gyr: Floats, acc: Floats, windows: Windows) -> Bools:
    """Whether anything moved in each of the windows.

    Medians take long, and lie between the least and the largest reading: where that decides they
    are not taken.
    """
    low, high = extremes(gyr, windows)
    gyr_moves, gyr_rests = spread(high - low, REST_GYR_RAD_S)
    least = np.where((low <= 0.0) & (high >= 0.0), 0.0, np.minimum(np.abs(low), np.abs(high)))
    largest = np.maximum(np.abs(low), np.abs(high))
    turns = np.linalg.norm(least, axis=1) > MOST_BIAS_RAD_S * (1.0 + ROUNDING)
    stands = np.linalg.norm(largest, axis=1) < MOST_BIAS_RAD_S * (1.0 - ROUNDING)
    low, high = extremes(acc, windows)
    acc_moves, acc_rests = spread(high - low, REST_ACC_M_S2)
    result: Bools = gyr_moves | acc_moves | turns
    for k in np.flatnonzero(~result & ~(gyr_rests & acc_rests & stands)).tolist():
        near = slice(windows.first[k], windows.behind[k])
        result[k] = not (_steady(gyr[near], REST_GYR_RAD_S) and _steady(acc[near], REST_ACC_M_S2))
        result[k] |= bool(np.linalg.norm(np.median(gyr[near], axis=0)) > MOST_BIAS_RAD_S)
    return result


def extremes(values: Floats, windows: Windows) -> tuple[Floats, Floats]:
    """The least and the largest (N, 3) of values (N, 3) in windows, by halves that overlap."""
    first, behind = windows
    low, high = values, values
    lowest, highest = np.empty((2, len(first), values.shape[1]))
    length, lengths = 1, behind - first
    while len(lengths) and length <= lengths.max():
        rows = np.flatnonzero((lengths >= length) & (lengths < 2 * length))
        one, other = first[rows], behind[rows] - length
        lowest[rows] = np.minimum(low[one], low[other])
        highest[rows] = np.maximum(high[one], high[other])
        low = np.minimum(low[:-length], low[length:])
        high = np.maximum(high[:-length], high[length:])
        length *= 2
    return lowest, highest


def spread(width: Floats, limit: float) -> tuple[Bools, Bools]:
    """Whether readings so far apart (N, 3) surely leave their median by ``limit``; surely not."""
    moves = 0.5 * width.max(axis=1, initial=0.0) > limit * (1.0 + ROUNDING)
    return moves, np.linalg.norm(width, axis=1) < limit * (1.0 - ROUNDING)


def _steady(window: Floats, limit: float) -> bool:
    """Whether nothing in the window (M, 3) is further than ``limit`` from its median."""
    off = np.linalg.norm(window - np.median(window, axis=0), axis=1)
    return bool(off.max() < limit)
