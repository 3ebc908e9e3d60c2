"""Overload as a state: what is left out so that the ticks stay on time.

More may arrive than a machine can handle. Then samples are taken at longer intervals, of each
vehicle the newest, and attitudes are published at a lower rate, in steps, until the threads have
time to rest again. It ends in the same steps.
"""

from typing import NamedTuple

# Of so many samples in a row of a vehicle that sends one a tick, one is taken, at the levels.
STRIDES = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
# Above this share of their time at work, threads are late now and then, and cannot catch up.
FULL = 0.9
FULL_WINDOWS = 2  # in a row for a beginning; one alone is vehicles that appear, another program
# The level falls where the one below would leave this much rest.
ROOM = 0.7
# So little work, all that is left out included, that the load is gone.
GONE = 0.3
# A level that was left and came back at once is left again after a longer time.
FIRST_PATIENCE_S = 1.0
LONGEST_PATIENCE_S = 8.0
SOON_S = 3.0


class Shedding(NamedTuple):
    """What is left out. ``samples``: one in so many is taken; ``attitudes``: one published."""

    samples: int = 1
    attitudes: int = 1

    @property
    def is_none(self) -> bool:
        """Whether nothing is left out."""
        return self.samples == 1


class Overload:
    """Finds how much must be left out from how busy the threads are. Times are given."""

    def __init__(self) -> None:
        self.level = 0
        self._full_windows = 0
        self._changed_s = 0.0
        self._lowered_s: float | None = None
        self._patience_s = FIRST_PATIENCE_S

    @property
    def shedding(self) -> Shedding:
        """What is left out now."""
        stride = STRIDES[self.level]
        return Shedding(stride, max(1, stride // 2))

    def observe(self, busy: float, now_s: float) -> bool:
        """Take the busiest thread's share of a window at work; True if the level changes."""
        before = self.level
        self._full_windows = self._full_windows + 1 if busy >= FULL else 0
        if self._full_windows >= (FULL_WINDOWS if self.level == 0 else 1):
            self._raise(now_s)
        elif self.level > 0 and self._has_room(busy) and self._is_patient(busy, now_s):
            self.level -= 1
            self._lowered_s = self._changed_s = now_s
        return self.level != before

    def _raise(self, now_s: float) -> None:
        self._full_windows = 0
        if self._lowered_s is not None:  # it was left, and is needed again
            soon = now_s - self._lowered_s < SOON_S
            longer_s = min(2.0 * self._patience_s, LONGEST_PATIENCE_S)
            self._patience_s = longer_s if soon else FIRST_PATIENCE_S
            self._lowered_s = None
        self.level = min(self.level + 1, len(STRIDES) - 1)
        self._changed_s = now_s

    def _has_room(self, busy: float) -> bool:
        return busy * STRIDES[self.level] / STRIDES[self.level - 1] < ROOM

    def _is_patient(self, busy: float, now_s: float) -> bool:
        """Whether it has been tried for long enough; not asked for where the load is gone."""
        gone = busy * STRIDES[self.level] < GONE
        return gone or now_s - self._changed_s >= self._patience_s
