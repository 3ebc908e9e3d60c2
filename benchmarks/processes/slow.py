"""A process that gets a share of one core alone, as on a small computer.

As a cgroup's ``cpu.max`` does it, for where none may be made: in each period it runs until it has
used its share, and is stopped (SIGSTOP) for the rest. Its processor's caches stay those of a fast
computer.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

PERIOD_S = 0.01  # a tenth of a cgroup's: it should be slow, not away
LOOK_S = 0.0005


@contextmanager
def slowed(process: int, share: float) -> Iterator[None]:
    """Have a process use no more than that share of a core, meanwhile; 1 leaves it alone."""
    is_over = threading.Event()
    thread = threading.Thread(target=_slow, args=(process, share, is_over), daemon=True)
    if share < 1.0:
        thread.start()
    try:
        yield
    finally:
        is_over.set()
        if share < 1.0:
            thread.join()


def _slow(process: int, share: float, is_over: threading.Event) -> None:
    clock = ~process << 3 | 2  # the processor's time of another process, clock_getcpuclockid(3)
    spare_s, before_s = 0.0, time.clock_gettime(clock)
    while not is_over.is_set():
        end_s = time.monotonic() + PERIOD_S
        spare_s = min(0.0, spare_s) + share * PERIOD_S  # what was too much counts, no rest is kept
        while time.monotonic() < end_s and spare_s > 0.0:
            time.sleep(LOOK_S)
            now_s = time.clock_gettime(clock)
            spare_s, before_s = spare_s - (now_s - before_s), now_s
        if time.monotonic() < end_s:
            os.kill(process, signal.SIGSTOP)
            time.sleep(max(0.0, end_s - time.monotonic()))
            os.kill(process, signal.SIGCONT)
