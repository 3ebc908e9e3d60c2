"""Where on a log the paper's cost is taken: stretches of 14 s that each start wrong.

The paper's J weighs the errors of the first second with 0.3 and those from 4
to 14 s with 1, at 100 Hz. On a log each sample stands for the time since the
one before, so the weights of a segment sum to what the paper's sum to, and
costs compare from one rate to another.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.geometry.metrics import STEADY, TRANSIENT, TRANSIENT_WEIGHT
from tuning.flight import Flight, Part

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SEGMENT_S = 14.0
TRANSIENT_S = (0.0, 1.0)
STEADY_S = (4.0, 14.0)
# The conditioning stage learns bias and field for so long before it is judged.
SETTLE_S = 10.0
# A segment holds no silence longer than this, or than so many sample periods if that is more.
LONGEST_GAP_S = 1.0
LONGEST_GAP_PERIODS = 4.0


class Segment(NamedTuple):
    """Samples first..last (both included); the estimate is set wrong at the first."""

    first: int
    last: int


def segments(part: Part) -> list[Segment]:
    """Segments of a part one after the other, none across a restart or a long silence."""
    flight = part.flight
    time_s = flight.time_s
    found = []
    for begin, end in _stretches(part):
        start_s = time_s[begin] + SETTLE_S
        while start_s + SEGMENT_S <= time_s[end - 1]:
            first = begin + int(np.searchsorted(time_s[begin:end], start_s))
            last = begin + int(np.searchsorted(time_s[begin:end], time_s[first] + SEGMENT_S + 1e-9))
            segment = Segment(first, last - 1)
            if _is_usable(flight, segment):
                found.append(segment)
            start_s = time_s[last - 1] + 1e-6
    return found


def weights(flight: Flight, segment: Segment) -> Array:
    """Weight of each of the segment's samples; their sum is the paper's."""
    t, known = _since_start(flight, segment)
    share = np.diff(t, prepend=-np.median(np.diff(t))) * known
    weight = np.zeros(len(t))
    for (low, high), total in (
        (TRANSIENT_S, TRANSIENT_WEIGHT * (TRANSIENT.stop - TRANSIENT.start)),
        (STEADY_S, float(STEADY.stop - STEADY.start)),
    ):
        part = np.where((t >= low) & (t <= high), share, 0.0)
        weight += part * total / part.sum() if part.sum() > 0.0 else 0.0
    return weight


def _stretches(part: Part) -> list[tuple[int, int]]:
    """Ranges of samples without a restart or a long silence inside."""
    flight = part.flight
    gap_s = np.diff(flight.time_s, prepend=flight.time_s[0])
    longest_s = max(LONGEST_GAP_S, LONGEST_GAP_PERIODS / flight.rate_hz)
    breaks = flight.restart | (gap_s > longest_s)
    starts = [part.first, *(k for k in np.flatnonzero(breaks).tolist() if k > part.first)]
    starts = [k for k in starts if k < part.last]
    return list(zip(starts, [*starts[1:], part.last], strict=True))


def _is_usable(flight: Flight, segment: Segment) -> bool:
    """Whether the start, and nearly all samples of both parts of the cost, have a reference."""
    if segment.last - segment.first < SEGMENT_S * min(flight.rate_hz, 1.0) / 2.0:
        return False
    t, known = _since_start(flight, segment)
    parts = [(t >= low) & (t <= high) for low, high in (TRANSIENT_S, STEADY_S)]
    return bool(known[0]) and all(part.any() and known[part].mean() > 0.9 for part in parts)


def _since_start(flight: Flight, segment: Segment) -> tuple[Array, NDArray[np.bool_]]:
    """Time since the segment's first sample, and where the reference is known."""
    inside = slice(segment.first, segment.last + 1)
    t = flight.time_s[inside]
    return t - t[0], flight.known[inside]
