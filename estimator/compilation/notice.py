"""Reports that something is being compiled, when it is: a minute of silence looks like a fault.

It imports nothing heavy, so that a command can use it long before numba is needed.
"""

import sys
from collections.abc import Callable

COMPILING = "compiling the filter: it takes a minute or so, and goes on then"

_listeners: list[Callable[[str], None]] = []
_asked: list[Callable[[str], None]] = []


def notify_compiling(tell: Callable[[str], None]) -> None:
    """Have ``tell`` called with a line, once, when the first kernel has to be compiled."""
    _listeners[:] = [tell]
    _asked[:] = [tell]


def notify_programs() -> None:
    """Have standard error told, for programs that are no command of ours and have not asked."""
    if not _asked:
        notify_compiling(lambda text: print(f"fuzzbee: {text}", file=sys.stderr, flush=True))


def compiling_begins() -> None:
    """A kernel is not in the cache; called by whoever compiles it, for each one."""
    while _listeners:
        _listeners.pop()(COMPILING)
