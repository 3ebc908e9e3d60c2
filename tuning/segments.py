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
from tuning.log_dataset import LogData

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
# Every third segment is kept out of the search, beginning with the second: of two, one.
HELD_OUT_EVERY = 3
HELD_OUT_FIRST = 1


class Segment(NamedTuple):
    """Samples first..last (both included); the estimate is set wrong at the first."""

    first: int
    last: int


def segments(data: LogData) -> list[Segment]:
    """Segments one after the other, none across a restart or a long silence.

    Without a reference every sample counts as known: the vectors are compared.
    """
    found = []
    for begin, end in _stretches(data):
        time_s = data.time_s[begin:end]
        start_s = time_s[0] + SETTLE_S
        while start_s + SEGMENT_S <= time_s[-1]:
            first = begin + int(np.searchsorted(time_s, start_s))
            last = begin + int(np.searchsorted(time_s, data.time_s[first] + SEGMENT_S + 1e-9)) - 1
            segment = Segment(first, last)
            if _is_usable(data, segment):
                found.append(segment)
            start_s = data.time_s[last] + 1e-6
    return found


def split(found: list[Segment]) -> tuple[list[Segment], list[Segment]]:
    """Segments to search on, and segments kept out of it."""
    held_out = found[HELD_OUT_FIRST::HELD_OUT_EVERY]
    return [s for s in found if s not in held_out], held_out


def weights(data: LogData, segment: Segment) -> Array:
    """Weight of each of the segment's samples; their sum is the paper's."""
    t = data.time_s[segment.first : segment.last + 1]
    t = t - t[0]
    known = data.known[segment.first : segment.last + 1] | (data.reference == "none")
    share = np.diff(t, prepend=-np.median(np.diff(t))) * known
    weight = np.zeros(len(t))
    for (low, high), total in (
        (TRANSIENT_S, TRANSIENT_WEIGHT * (TRANSIENT.stop - TRANSIENT.start)),
        (STEADY_S, float(STEADY.stop - STEADY.start)),
    ):
        part = np.where((t >= low) & (t <= high), share, 0.0)
        weight += part * total / part.sum() if part.sum() > 0.0 else 0.0
    return weight


def _stretches(data: LogData) -> list[tuple[int, int]]:
    """Ranges of samples without a restart or a long silence inside."""
    gap_s = np.diff(data.time_s, prepend=data.time_s[0])
    longest_s = max(LONGEST_GAP_S, LONGEST_GAP_PERIODS / data.rate_hz)
    starts = np.flatnonzero(data.restart | (gap_s > longest_s)).tolist()
    return list(zip(starts, [*starts[1:], len(gap_s)], strict=True))


def _is_usable(data: LogData, segment: Segment) -> bool:
    """Whether the start, and nearly all samples of both parts of the cost, have a reference."""
    if segment.last - segment.first < SEGMENT_S * min(data.rate_hz, 1.0) / 2.0:
        return False
    t = data.time_s[segment.first : segment.last + 1]
    t = t - t[0]
    known = data.known[segment.first : segment.last + 1] | (data.reference == "none")
    parts = [(t >= low) & (t <= high) for low, high in (TRANSIENT_S, STEADY_S)]
    return bool(known[0]) and all(part.any() and known[part].mean() > 0.9 for part in parts)
