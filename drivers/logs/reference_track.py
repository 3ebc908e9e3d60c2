"""A reference attitude as a function of time: somebody else's samples, interpolated."""

from array import array

import numpy as np
from numpy.typing import NDArray

from drivers.events import ReferenceAttitude
from estimator.geometry.quaternion import slerp
from estimator.types import Quaternion

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Between two samples this many median periods apart the reference may have
# done anything; half a second is tolerable for the slowest streams.
GAP_PERIODS = 2.5
GAP_MINIMUM_US = 500_000
# A sample of another message of the same batch counts as simultaneous.
EDGE_US = 100_000


class ReferenceTrack:
    """Collects one source's attitudes and answers for any time near them."""

    def __init__(self) -> None:
        self._times: dict[str, array[int]] = {}
        self._attitudes: dict[str, array[float]] = {}

    def add(self, event: ReferenceAttitude) -> None:
        """Take one attitude; the messages of a source are kept apart."""
        if event.message not in self._times:
            self._times[event.message], self._attitudes[event.message] = array("q"), array("d")
        self._times[event.message].append(event.time_us)
        self._attitudes[event.message].extend(event.q_ned_frd)

    @property
    def message(self) -> str | None:
        """The message that says most, of equals the first by name; None without any."""
        if not self._times:
            return None
        return min(self._times, key=lambda name: (-len(self._times[name]), name))

    def at(self, times_us: Ints) -> tuple[Floats, NDArray[np.bool_]]:
        """Attitudes (N, 4) at ascending times (N,), and where they are known."""
        attitudes = np.tile([1.0, 0.0, 0.0, 0.0], (len(times_us), 1))
        known = np.zeros(len(times_us), dtype=bool)
        if self.message is None:
            return attitudes, known
        t, unique = np.unique(
            np.array(self._times[self.message], dtype=np.int64), return_index=True
        )
        q = np.array(self._attitudes[self.message]).reshape(-1, 4)[unique]
        longest_us = self._longest_gap_us(t)
        following = np.searchsorted(t, times_us)
        for k, i in enumerate(following):
            near = self._interpolate(int(times_us[k]), t, q, int(i), longest_us)
            if near is not None:
                attitudes[k] = near
                known[k] = True
        return attitudes, known

    @staticmethod
    def _longest_gap_us(t: Ints) -> float:
        median = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
        return max(GAP_MINIMUM_US, GAP_PERIODS * median)

    @staticmethod
    def _interpolate(
        time_us: int, t: Ints, q: Floats, i: int, longest_us: float
    ) -> Quaternion | None:
        if i < len(t) and t[i] == time_us:
            return row(q, i)
        if 0 < i < len(t) and t[i] - t[i - 1] <= longest_us:
            fraction = (time_us - int(t[i - 1])) / float(t[i] - t[i - 1])
            return slerp(row(q, i - 1), row(q, i), fraction)
        for j in (i - 1, i):
            if 0 <= j < len(t) and abs(int(t[j]) - time_us) <= EDGE_US:
                return row(q, j)
        return None


def row(q: Floats, k: int) -> Quaternion:
    """A row of quaternions (N, 4)."""
    w, x, y, z = q[k].tolist()
    return w, x, y, z
