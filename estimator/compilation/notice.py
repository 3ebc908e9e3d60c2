"""Reports that something is being compiled, when it is: a minute of silence looks like a fault.

It imports nothing heavy, so that a command can use it long before numba is needed.
"""

import sys
from collections.abc import Callable

COMPILING = "compiling the filter: it takes a minute or so, and goes on then"

_listeners: list[Callable[[str], None]] = []
_asked: list[Callable[[str], None]] = []


def notify_compiling(notify: Callable[[str], None]) -> None:
    """Call ``notify`` with a line, once, when the first kernel has to be compiled."""
    _listeners[:] = [notify]
    _asked[:] = [notify]


def notify_programs() -> None:
    """Write to standard error, for programs other than our command that have not asked."""
    if not _asked:
        notify_compiling(lambda text: print(f"fuzzbee: {text}", file=sys.stderr, flush=True))


def compiling_begins() -> None:
    """Notify that a kernel is not in the cache; called before each one is compiled."""
    while _listeners:
        _listeners.pop()(COMPILING)
