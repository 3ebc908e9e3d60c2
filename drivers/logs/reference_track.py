"""A reference attitude as a function of time: somebody else's samples, interpolated."""

import numpy as np
from numpy.typing import NDArray

from drivers.events import ReferenceAttitude
from drivers.logs.percentile import percentile
from drivers.logs.spill_file import SpillFile
from estimator.arrays import Floats, Ints
from estimator.geometry.quaternion import slerp
from estimator.types import Quaternion

# Between two samples this many median periods apart the reference may have
# done anything; half a second is tolerable for the slowest streams.
GAP_PERIODS = 2.5
GAP_MINIMUM_US = 500_000
# A sample of another message of the same batch counts as simultaneous.
EDGE_US = 100_000


class ReferenceTrack:
    """Collects one source's attitudes and answers for any time near them."""

    def __init__(self) -> None:
        self._messages: dict[str, tuple[SpillFile, SpillFile]] = {}
        self._longest: tuple[str | None, int, float] = (None, 0, 0.0)

    def add(self, event: ReferenceAttitude) -> None:
        """Take one attitude, later than the last; the messages of a source are kept apart."""
        if event.message not in self._messages:
            self._messages[event.message] = SpillFile("q"), SpillFile("d", 4)
        times_us, attitudes = self._messages[event.message]
        if not len(times_us) or event.time_us > times_us.latest:
            times_us.extend((event.time_us,))
            attitudes.extend(event.q_ned_frd)

    @property
    def message(self) -> str | None:
        """The message that says most, of equals the first by name; None without any."""
        count = {name: len(times_us) for name, (times_us, _) in self._messages.items()}
        return min(count, key=lambda name: (-count[name], name), default=None)

    def at(self, times_us: Ints) -> tuple[Floats, NDArray[np.bool_]]:
        """Attitudes (N, 4) at ascending times (N,), and where they are known."""
        attitudes = np.tile([1.0, 0.0, 0.0, 0.0], (len(times_us), 1))
        known = np.zeros(len(times_us), dtype=bool)
        message = self.message
        if message is None or not len(times_us):
            return attitudes, known
        track, turned = self._messages[message]
        longest_us = self._longest_gap_us(message)
        near = slice(
            max(track.first_from(times_us[0]) - 1, 0), track.first_from(times_us[-1] + 1) + 1
        )
        t, q = track.rows(near), turned.rows(near)
        following = np.searchsorted(t, times_us)
        for k, i in enumerate(following):
            found = self._interpolate(int(times_us[k]), t, q, int(i), longest_us)
            if found is not None:
                attitudes[k] = found
                known[k] = True
        return attitudes, known

    def _longest_gap_us(self, message: str) -> float:
        times_us, _ = self._messages[message]
        if self._longest[:2] != (message, len(times_us)):
            median = percentile(times_us.steps, 50.0) if len(times_us) > 1 else 0.0
            longest_us = max(GAP_MINIMUM_US, GAP_PERIODS * median)
            self._longest = (message, len(times_us), longest_us)
        return self._longest[2]

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
