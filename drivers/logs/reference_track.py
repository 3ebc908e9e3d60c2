"""A reference attitude as a function of time: somebody else's samples, interpolated."""

import numpy as np

from drivers.events import ReferenceAttitude
from drivers.logs.table import Table
from estimator.geometry.rotations import conjugate, exp, log, multiply
from estimator.types import Floats, Times

# Between two samples this many median periods apart the reference may have
# done anything; half a second is tolerable for the slowest streams.
GAP_PERIODS = 2.5
GAP_MINIMUM_US = 500_000
# A sample of another message of the same batch counts as simultaneous.
EDGE_US = 100_000


class ReferenceTrack:
    """Collects one source's attitudes and answers for any time near them."""

    def __init__(self) -> None:
        self._messages: dict[str, Table] = {}
        self._latest_us: dict[str, int] = {}

    def add(self, event: ReferenceAttitude) -> None:
        """Take one attitude, later than the last; the messages of a source are kept apart."""
        name = event.message
        if name not in self._messages:
            self._messages[name] = Table(time_us="i8", q_ned_frd="4f8")
        elif event.time_us <= self._latest_us[name]:
            return
        self._latest_us[name] = event.time_us
        self._messages[name].append(event.time_us, event.q_ned_frd)

    @property
    def message(self) -> str | None:
        """The message that came most often, of equals the first by name; None without any."""
        count = {name: len(track) for name, track in self._messages.items()}
        return min(count, key=lambda name: (-count[name], name), default=None)

    def at(self, times_us: Times) -> Floats:
        """Attitudes (N, 4) at times (N,), NaN where they are not known."""
        message = self.message
        if message is None:
            return np.full((len(times_us), 4), np.nan)
        track = self._messages[message]
        return attitudes_at(times_us, track["time_us"], track["q_ned_frd"])


def attitudes_at(times_us: Times, known_us: Times, q: Floats) -> Floats:
    """Attitudes (N, 4) at times (N,) between those (M, 4) at ascending times (M,); NaN in gaps.

    Beyond a gap's edge the nearest holds for a moment.
    """
    found = np.full((len(times_us), 4), np.nan)
    median_us = float(np.median(np.diff(known_us))) if len(known_us) > 1 else 0.0
    following = np.searchsorted(known_us, times_us)
    after, before = np.minimum(following, len(known_us) - 1), np.maximum(following - 1, 0)
    for beside in (after, before):
        is_near = np.abs(known_us[beside] - times_us) <= EDGE_US
        found[is_near] = q[beside[is_near]]
    length_us = known_us[after] - known_us[before]
    is_between = (known_us[before] < times_us) & (times_us < known_us[after])
    is_between &= length_us <= max(GAP_MINIMUM_US, GAP_PERIODS * median_us)
    first, last = q[before[is_between]], q[after[is_between]]
    share = (times_us - known_us[before])[is_between] / length_us[is_between]
    # along the shorter arc: p exp(share log(p* q))
    found[is_between] = multiply(first, exp(share[:, None] * log(multiply(conjugate(first), last))))
    is_exact = known_us[after] == times_us
    found[is_exact] = q[after[is_exact]]
    return found
