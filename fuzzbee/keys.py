"""Single keys from a terminal, without Enter and without an echo."""

import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

SEQUENCES = {"\x1b[A": "up", "\x1b[B": "down", "\x1bOA": "up", "\x1bOB": "down", "\x1b": "escape"}
WORDS = {"\r": "enter", "\n": "enter"}
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
        return list(_keys(text))


def _keys(text: str) -> Iterator[str]:
    while text:
        taken = next((s for s in SEQUENCES if text.startswith(s)), text[0])
        yield SEQUENCES.get(taken) or WORDS.get(taken, taken)
        text = text[len(taken) :]


@contextmanager
def terminal_keys() -> Iterator[Keys]:
    """Keys of standard input while it is a terminal that is ours; Ctrl-C stays what it is."""
    descriptor = _own_terminal()
    if descriptor is None:
        yield Keys(None)
        return
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor, termios.TCSANOW)
        yield Keys(descriptor)
    finally:
        with suppress(termios.error, OSError):
            termios.tcsetattr(descriptor, termios.TCSANOW, before)


def _own_terminal() -> int | None:
    """Standard input, if it is a terminal and we are in its foreground: others would be stopped."""
    try:
        descriptor = sys.stdin.fileno()
        if os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp():
            import termios

            termios.tcgetattr(descriptor)
            return descriptor
    except (OSError, ValueError, AttributeError, ImportError):
        pass
    return None
