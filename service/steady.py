"""Python settings for a process that must keep a schedule, once all is loaded and compiled."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# A thread that computes hands over Python's lock when another thread has waited for it this long.
# The usual 5 ms would make ticks late. With a much shorter time threads interrupt each other so
# often that, at 100 vehicles, a fifth of the time is lost.
SWITCH_INTERVAL_S = 5e-4


@contextmanager
def steady() -> Iterator[None]:
    """While it lasts, the garbage collector leaves alone what existed before.

    Half a million objects of libraries never become garbage. Looking through them takes 0.1 s,
    several ticks.
    """
    interval_s = sys.getswitchinterval()
    gc.freeze()  # without collecting first, which takes as long and finds little
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        gc.unfreeze()
