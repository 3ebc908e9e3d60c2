"""Readings as means over short windows, and low-passes of those without a delay."""

from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from estimator.conditioning.vertical.averaging import WINDOW_S
from estimator.types import Bools, Floats

# A low-pass begins and ends with what lies within so many of its time constants, mirrored.
MIRRORED_TAUS = 4.0


class Windows(NamedTuple):
    """Windows of ``WINDOW_S`` and the samples in them."""

    time_s: Floats  # (W,) their middles
    first: Floats  # (W + 1,) the sample that each begins with, and the one behind the last

    def means(self, values: Floats, counts: Bools | None = None) -> tuple[Floats, Floats]:
        """Means (W, ...) over the samples that count, and how many there are (W,).

        A window without any has 0.
        """
        is_in = np.ones(len(values)) if counts is None else counts.astype(float)
        n = self._sums(is_in)
        weights = is_in.reshape(-1, *[1] * (values.ndim - 1))
        sums = self._sums(np.where(weights > 0.0, values, 0.0))
        return sums / np.maximum(n, 1.0).reshape(-1, *[1] * (values.ndim - 1)), n

    def _sums(self, values: Floats) -> Floats:
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        return np.asarray(total[self.first[1:]] - total[self.first[:-1]])

    def at(self, time_s: Floats, values: Floats) -> Floats:
        """Values (W,) or (W, K) of the windows, at other times (N,)."""
        if values.ndim == 1:
            return np.interp(time_s, self.time_s, values)
        return np.stack([np.interp(time_s, self.time_s, v) for v in values.T], axis=-1)


def windows_of(time_s: Floats) -> Windows:
    """The windows of samples at these times (N,)."""
    count = max(1, round((time_s[-1] - time_s[0]) / WINDOW_S))
    edges = time_s[0] + WINDOW_S * np.arange(count + 1)
    first = np.searchsorted(time_s, edges)
    first[-1] = len(time_s)
    return Windows(edges[:-1] + 0.5 * WINDOW_S, first)


def filled(values: Floats, known: Bools) -> Floats:
    """The values (W, K), interpolated where they are not known."""
    if known.all() or not known.any():
        return values
    at = np.arange(len(values))
    return np.stack([np.interp(at, at[known], v[known]) for v in values.T], axis=-1)


def low_passed(values: Floats, tau_s: float) -> Floats:
    """The values of windows, (W, K), after a Butterworth filter of second order, there and back.

    Its cutoff is that of the estimator's own low-pass of the same time constant.
    """
    cutoff_hz = np.sqrt(2.0) / (2.0 * np.pi * tau_s)
    share = 2.0 * cutoff_hz * WINDOW_S
    if share >= 1.0 or len(values) < 2:
        return values
    mirrored = min(len(values) - 1, round(MIRRORED_TAUS * tau_s / WINDOW_S))
    sos = butter(2, share, output="sos")
    return np.asarray(sosfiltfilt(sos, values, axis=0, padtype="even", padlen=mirrored))


def running_mean(values: Floats, count: int) -> Floats:
    """Means (W,) over ``count`` windows around each; fewer at the ends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    at = np.arange(len(values))
    begin = np.maximum(at - count // 2, 0)
    end = np.minimum(at + count - count // 2, len(values))
    return np.asarray((total[end] - total[begin]) / (end - begin))
