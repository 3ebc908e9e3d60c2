"""Ctrl-C while the command's own modules are still being imported: an end, not a traceback.

Importing this module switches that on, so the command does it before all other imports;
:func:`end` gives signals back to Python. It imports next to nothing itself.
"""

import _signal  # type: ignore[import-not-found]  # what ``signal`` wraps, there from the start
import os
import sys

INTERRUPTED = 130
ENDLESS = ("run", "sim", "watch")  # verbs for which a signal is the regular end


def is_endless(arguments: list[str]) -> bool:
    """Whether a signal is the regular end of the verb."""
    return next((word for word in arguments if not word.startswith("-")), None) in ENDLESS


def _leave(_number: int, _frame: object) -> None:
    os._exit(0 if is_endless(sys.argv[1:]) else INTERRUPTED)


def _begin() -> None:
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        try:
            _signal.signal(_signal.SIGINT, _leave)
        except ValueError:  # not in the main thread: somebody else's program imports us
            return


def end() -> None:
    """From here on an interrupt is an exception again."""
    if _signal.getsignal(_signal.SIGINT) is _leave:
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


_begin()
