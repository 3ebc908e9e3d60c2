"""What a process with a schedule asks of Python, once all has been loaded and compiled."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# A thread that computes gives Python's lock away when another has asked for it this long. The
# usual 5 ms would make ticks late. Much less makes threads take it from one another in mid-work,
# again and again, which at 100 vehicles costs a fifth of the time.
SWITCH_INTERVAL_S = 5e-4


@contextmanager
def steady() -> Iterator[None]:
    """Within it, no pauses of the garbage collector for what was there before.

    Half a million objects of libraries never become garbage; to look through them takes 0.1 s,
    which would be several ticks.
    """
    interval_s = sys.getswitchinterval()
    gc.freeze()  # with what is garbage already, which is little: to collect it first takes as long
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval_s)
        gc.unfreeze()
