"""Python settings for a process that must keep a schedule, once all is loaded and compiled."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# A thread that computes hands over Python's lock when another thread has waited for it this long.
# The usual 5 ms would make ticks late. With a much shorter time threads interrupt each other so
# often that, at 100 vehicles, a fifth of the time is lost.
SWITCH_INTERVAL_S = 5e-4
ADD_EVERY_S = 1.0
# With hundreds of vehicles a tick alone makes thousands of records, which go again without help.
MANY_OBJECTS = 50_000


class Frozen:
    """What the garbage collector leaves alone."""

    def __init__(self) -> None:
        self._vehicles = 0
        self._due_s = 0.0

    def add(self, vehicles: int, now_s: float) -> None:
        """Add what has come with vehicles, at most once a second; there are so many now.

        Each brings a thousand objects that stay.
        """
        if now_s < self._due_s:
            return
        self._due_s = now_s + ADD_EVERY_S
        if vehicles > self._vehicles:
            gc.freeze()
        self._vehicles = vehicles


@contextmanager
def steady() -> Iterator[Frozen]:
    """While it lasts, the garbage collector leaves alone what existed before, and what is added.

    Half a million objects of libraries never become garbage. Looking through them takes 0.1 s,
    several ticks.
    """
    interval_s, thresholds = sys.getswitchinterval(), gc.get_threshold()
    gc.set_threshold(MANY_OBJECTS, *thresholds[1:])
    gc.freeze()  # without collecting first, which takes as long and finds little
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield Frozen()
    finally:
        sys.setswitchinterval(interval_s)
        gc.set_threshold(*thresholds)
        gc.unfreeze()
