"""When the vehicle moved, judged by its raw IMU samples and not by any estimate."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.types import ImuSample

# At rest the gyroscope and the accelerometer stay this near their medians over the window.
REST_GYR_RAD_S = np.radians(2.0)
REST_ACC_M_S2 = 0.3
# A steady rate above this is a turn: the bias of a gyroscope is smaller.
MOST_BIAS_RAD_S = np.radians(4.0)
WINDOW_S = 1.5  # before a sample, and again behind it


def motion_mask(samples: Sequence[ImuSample]) -> NDArray[np.bool_]:
    """(N,): whether anything moved within ``WINDOW_S`` of each sample."""
    times_s = np.array([sample.time_us for sample in samples]) * 1e-6
    gyr = np.array([sample.gyr_rad_s for sample in samples]).reshape(-1, 3)
    acc = np.array([sample.acc_m_s2 for sample in samples]).reshape(-1, 3)
    first = np.searchsorted(times_s, times_s - WINDOW_S)
    behind = np.searchsorted(times_s, times_s + WINDOW_S, side="right")
    result = np.empty(len(samples), dtype=bool)
    for k in range(len(samples)):
        near = slice(first[k], behind[k])
        result[k] = not (_steady(gyr[near], REST_GYR_RAD_S) and _steady(acc[near], REST_ACC_M_S2))
        result[k] |= bool(np.linalg.norm(np.median(gyr[near], axis=0)) > MOST_BIAS_RAD_S)
    return result


def _steady(window: NDArray[np.float64], limit: float) -> bool:
    """Whether nothing in the window (M, 3) is further than ``limit`` from its median."""
    off = np.linalg.norm(window - np.median(window, axis=0), axis=1)
    return bool(off.max() < limit)
