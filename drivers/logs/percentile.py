"""Percentiles of numbers that need not be in memory all at once."""

from collections.abc import Callable, Iterable
from math import floor

import numpy as np

from drivers.logs.spill_file import BLOCK
from estimator.arrays import Floats

Parts = Callable[[], Iterable[Floats]]

DIGIT_BITS = 16


def percentile(parts: Parts, percent: float) -> float:
    """NumPy's percentile, of numbers that are not negative; NaN if there are none.

    ``parts`` gives the same parts as often as it is called.
    """
    n = sum(map(len, parts()))
    if n <= BLOCK:
        values = [part for part in parts() if len(part)]
        return float(np.percentile(np.concatenate(values), percent)) if values else np.nan
    place = percent / 100.0 * (n - 1)
    low = _ranked(parts, floor(place))
    return low + (place - floor(place)) * (_ranked(parts, min(floor(place) + 1, n - 1)) - low)


def _ranked(parts: Parts, rank: int) -> float:
    """The number of that rank, digit by digit: floats and their bits have one order."""
    found = 0
    for shift in range(64 - DIGIT_BITS, -1, -DIGIT_BITS):
        counts = np.zeros(1 << DIGIT_BITS, np.int64)
        for part in parts():
            bits = (part + 0.0).view(np.uint64) >> np.uint64(shift)
            digits = bits[bits >> np.uint64(DIGIT_BITS) == np.uint64(found)]
            counts += np.bincount(
                (digits & np.uint64((1 << DIGIT_BITS) - 1)).astype(np.int64), minlength=len(counts)
            )
        behind = np.cumsum(counts)
        digit = int(np.searchsorted(behind, rank, side="right"))
        rank -= int(behind[digit] - counts[digit])
        found = found << DIGIT_BITS | digit
    return float(np.uint64(found).view(np.float64))
