"""What a line over time is drawn of: no more points than are seen, and none across a gap."""

import numpy as np

from estimator.arrays import Floats
from fuzzbee.replays.bands import gaps

# With more points a line looks the same and the file only grows.
MOST_POINTS = 20_000


class Thinned:
    """The points of lines over samples at times (N,); ``time_s`` are theirs, (M,)."""

    def __init__(self, time_s: Floats) -> None:
        self._step = 1 + len(time_s) // MOST_POINTS
        shown_s, spans = time_s[:: self._step], np.reshape(gaps(time_s), (-1, 2))
        self._breaks = np.searchsorted(shown_s, spans[:, 1])
        self.time_s = np.insert(shown_s, self._breaks, spans.mean(axis=1))

    def every(self, values: Floats) -> Floats:
        """Some of the values (N,) or (N, K), and NaN in each gap."""
        return self._broken(values[:: self._step])

    def largest(self, values: Floats) -> Floats:
        """The same of values whose peaks tell: the largest around each."""
        return self._broken(largest(values, self._step))

    def _broken(self, values: Floats) -> Floats:
        return np.insert(values, self._breaks, np.nan, axis=0)


def largest(values: Floats, count: int) -> Floats:
    """The largest of every ``count`` values (N,) or (N, K); NaN where none is known."""
    return np.asarray(np.fmax.reduceat(values, np.arange(0, len(values), count)))
