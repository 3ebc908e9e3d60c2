"""Says that something is being compiled, when it is: half a minute of silence looks like a fault.

It imports nothing heavy, so that a command can use it long before numba is needed.
"""

import sys
from collections.abc import Callable

FIRST_TIME = "compiling the filter, the first time only"
EACH_TIME = "compiling the filter"  # where it cannot be kept

_listeners: list[Callable[[str], None]] = []
_told: list[Callable[[str], None]] = []  # whoever has asked


def tell_compiling(tell: Callable[[str], None]) -> None:
    """Have ``tell`` called with a line, once, when the first kernel has to be compiled."""
    _listeners[:] = [tell]
    _told[:] = [tell]


def tell_programs() -> None:
    """Have standard error told, for programs that are no command of ours and have not asked."""
    if not _told:
        tell_compiling(
            lambda text: print(f"fuzzbee: {text}, half a minute", file=sys.stderr, flush=True)
        )


def compiling_begins(*, is_kept: bool) -> None:
    """A kernel is not in the cache; called by whoever compiles it, for each one."""
    while _listeners:
        _listeners.pop()(FIRST_TIME if is_kept else EACH_TIME)
