"""Single keys from a terminal, without Enter and without an echo."""

import os
import re
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

NAMES = {"\x1b": "escape", "\r": "enter", "\n": "enter"}
NAMES |= {"\x1b[A": "up", "\x1bOA": "up", "\x1b[B": "down", "\x1bOB": "down"}
MOST_BYTES = 64


class Keys:
    """The keys that were pressed since they were asked for last; none without a terminal."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    def pressed(self) -> list[str]:
        """Letters, and ``up``, ``down``, ``enter``, ``escape``; never waits."""
        if self._descriptor is None:
            return []
        try:
            if not select.select([self._descriptor], [], [], 0.0)[0]:
                return []
            text = os.read(self._descriptor, MOST_BYTES).decode("ascii", "ignore")
        except (OSError, ValueError):
            text = ""
        if not text:  # the terminal is gone
            self._descriptor = None
        found = re.findall(r"\x1b[\[O][AB]|.", text, re.DOTALL)
        return [NAMES.get(key, key) for key in found]


@contextmanager
def terminal_keys() -> Iterator[Keys]:
    """Keys of standard input while it is a terminal that is ours; Ctrl-C stays what it is."""
    try:
        import termios
        import tty

        descriptor = sys.stdin.fileno()
        # in its background we would be stopped
        if not os.isatty(descriptor) or os.tcgetpgrp(descriptor) != os.getpgrp():
            raise OSError  # noqa: TRY301
        before = termios.tcgetattr(descriptor)
    except (OSError, ValueError, AttributeError, ImportError):
        yield Keys(None)
        return
    try:
        tty.setcbreak(descriptor, termios.TCSANOW)
        yield Keys(descriptor)
    finally:
        with suppress(termios.error, OSError):
            termios.tcsetattr(descriptor, termios.TCSANOW, before)
