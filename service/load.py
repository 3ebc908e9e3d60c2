"""What the loop shows the pipeline about itself: its losses, and overload as a state.

What is left out is decided where frames wait (``drivers.mavlink.limits``), from moment to moment.
A short stall leaves something out, too, and is no overload.
"""

from math import inf
from typing import NamedTuple


class Load(NamedTuple):
    """Whether the loop leaves anything out now.

    ``rate_hz`` is how often attitudes are published where there is time for it. While it
    ``is_shedding``, only vehicles with a new sample have theirs published. Right after a stop
    (``has_just_woken``) nobody can tell yet whose silence is his own.
    """

    is_shedding: bool = False
    has_just_woken: bool = False
    rate_hz: float = 0.0


class Losses(NamedTuple):
    """What the loop has lost so far; only statuses show it.

    ``overruns`` are late ticks, ``dropped`` events and records thrown away, ``lost`` datagrams that
    the system threw away. ``recording`` is a word on the files that are recorded to.
    """

    overruns: int = 0
    dropped: int = 0
    lost: int = 0
    recording: str = ""


# Samples left out in that many windows in a row begin an overload, and as long without any end it.
WINDOW_S = 0.25
WINDOWS_TO_BEGIN = 2
WINDOWS_TO_END = 4

BEGINS = (
    "overloaded: more arrives than this computer can handle; "
    "of each vehicle the newest samples are taken, and the ticks stay on time"
)
ENDS = "no longer overloaded: every sample counts again"


class Overload:
    """Follows a count of what has been left out so far. Times are given, in s."""

    def __init__(self) -> None:
        self.is_on = False
        self.due_s = -inf  # before that a count says nothing
        self._count: int | None = None
        self._windows = 0  # in a row that speak against the present state

    @property
    def line(self) -> str:
        """The present state, for a person."""
        return BEGINS if self.is_on else ENDS

    def observe(self, left_out: int, now_s: float) -> bool:
        """Take the count at ``now_s``; True if the overload begins or ends."""
        if now_s < self.due_s:
            return False
        before, self._count, self.due_s = self._count, left_out, now_s + WINDOW_S
        if before is None:
            return False
        is_full = left_out > before
        self._windows = self._windows + 1 if is_full != self.is_on else 0
        if self._windows < (WINDOWS_TO_END if self.is_on else WINDOWS_TO_BEGIN):
            return False
        self.is_on, self._windows = not self.is_on, 0
        return True
