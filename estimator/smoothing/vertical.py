"""The vertical of a fast stream without velocity: the felt force in G, averaged both ways.

For how long, the force of the whole recording shows, see :mod:`...vertical.averaging`.
"""

from typing import Any, NamedTuple

import numpy as np

from estimator.conditioning.params import LATELY_S
from estimator.conditioning.sigma import MEASURED_SQUARE
from estimator.conditioning.vertical.averaging import (
    OCTAVES,
    TAU_SHARE,
    WINDOW_S,
    Averaging,
    Octave,
    best_window,
)
from estimator.conditioning.vertical.stillness import LEAST_DIRECTION_RAD
from estimator.estimator import Estimator
from estimator.geometry.rotations import multiply, rotate, unit
from estimator.smoothing.path import Path
from estimator.smoothing.windows import Windows, filled, low_passed, running_mean
from estimator.types import STANDARD_GRAVITY_M_S2, Floats


class Vertical(NamedTuple):
    """The path levelled: its heading is arbitrary, and drifts."""

    q_6d_frd: Floats  # (N, 4)
    sigma_rad: Floats  # (N,)
    variance: Floats  # (W,) of the windows, rad^2


def level(last: Estimator, windows: Windows, path: Path, down_g: Floats) -> Vertical:
    """The vertical by the force ``down_g`` (N, 3) in G."""
    felt, samples = windows.means(down_g)
    felt = filled(felt, samples > 0.0)
    rate_g, _ = windows.means(rotate(path.q_g_frd, path.rate_rad_s))
    length_s = best_length_s(last, felt, WINDOW_S * rate_g)
    down = low_passed(felt, TAU_SHARE * length_s)
    variance = LEAST_DIRECTION_RAD**2 + local_variance(felt, max(1, round(length_s / WINDOW_S)))
    count = round(LATELY_S / WINDOW_S)
    size = np.linalg.norm(down, axis=1) / STANDARD_GRAVITY_M_S2 - 1.0
    variance += MEASURED_SQUARE * running_mean(size**2, count)
    x, y, z = unit(windows.at(path.time_s, down)).T
    to_down = np.stack([1.0 + z, y, -x, np.zeros_like(x)], axis=-1)
    to_down[z < -1.0 + 1e-12] = (0.0, 1.0, 0.0, 0.0)  # half a turn of what points straight up
    q = multiply(unit(to_down), path.q_g_frd)
    return Vertical(q, np.sqrt(windows.at(path.time_s, variance)), variance)


def best_length_s(last: Estimator, felt: Floats, turned: Floats) -> float:
    """For how long the force of windows (W, 3), in which the body ``turned`` (rad), is averaged."""
    octaves: list[Octave] = []
    count = len(felt)
    for _ in range(OCTAVES):
        apart = 0.5 * np.mean(turns_squared(felt[:-1], felt[1:])) if len(felt) > 1 else 0.0
        turning = np.mean(np.sum(turned**2, axis=1)) if len(felt) > 1 else 0.0
        octaves.append(Octave(apart=float(apart), turning=float(turning)))
        pairs = len(felt) // 2 * 2
        felt = 0.5 * (felt[0:pairs:2] + felt[1:pairs:2])
        turned = turned[0:pairs:2] + turned[1:pairs:2]
    all_of_them: Any = tuple(octaves)
    seen = Averaging(octaves=all_of_them, windows=count, moved_s=WINDOW_S * count)
    p = last.core.conditioning.vertical.estimate.covariance
    return best_window(last.settings.conditioning, seen, (p[0] + p[4] + p[7]) / 3.0)[0]


def local_variance(felt: Floats, length: int) -> Floats:
    """Half the mean square turn (W,) of means over ``length`` windows, from those around each."""
    means = np.stack([running_mean(component, length) for component in felt.T], axis=-1)
    n = len(felt)
    at = np.arange(n)
    before, behind = np.maximum(at - length // 2, 0), np.minimum(at + (length + 1) // 2, n - 1)
    return running_mean(0.5 * turns_squared(means[before], means[behind]), 4 * length)


def turns_squared(before: Floats, after: Floats) -> Floats:
    """Squared angles (N,) between vectors (N, 3)."""
    sine = np.linalg.norm(np.cross(before, after), axis=1)
    return np.asarray(np.arctan2(sine, np.sum(before * after, axis=1)) ** 2)
