"""A command in a terminal of its own: a pseudo-terminal, and pyte, which draws what is written."""

import os
import select
import signal
import subprocess
import sys
import termios
import time
from contextlib import contextmanager
from functools import partial

import pyte

COLUMNS, ROWS = 80, 24  # at first


class Terminal:
    """What a person sees."""

    def __init__(self, descriptor, process):
        self._descriptor = descriptor
        self.process = process
        self._screen = pyte.Screen(COLUMNS, ROWS)
        self._stream = pyte.ByteStream(self._screen)
        self.written = b""

    def press(self, keys):
        os.write(self._descriptor, keys.encode())

    def resize(self, columns, rows):
        termios.tcsetwinsize(self._descriptor, (rows, columns))
        self._screen.resize(rows, columns)
        self.process.send_signal(signal.SIGWINCH)

    def wait_for(self, condition, timeout_s=60.0):
        """Read until ``condition(lines)`` holds."""
        end_s = time.monotonic() + timeout_s
        while not condition(self._screen.display):
            assert time.monotonic() < end_s, "\n".join(self._screen.display)
            self.read(0.1)

    def read(self, seconds):
        """Take in what comes in so long, or up to the end."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0.0:
            try:
                ready, _, _ = select.select([self._descriptor], [], [], left_s)
                data = os.read(self._descriptor, 65536) if ready else b""
            except OSError:  # the other side is closed
                return
            self.written += data
            self._stream.feed(data)


@contextmanager
def terminal(*arguments):
    """``fuzzbee`` with these arguments; it is ended with the context."""
    ours, its = os.openpty()
    termios.tcsetwinsize(its, (ROWS, COLUMNS))
    kept = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES", "NO_COLOR")}
    process = subprocess.Popen(
        [sys.executable, "-m", "fuzzbee", *arguments],
        env={**kept, "TERM": "xterm-256color", "COLORTERM": "truecolor"},
        preexec_fn=partial(os.login_tty, its),  # noqa: PLW1509 - one call
        pass_fds=(its,),
    )
    os.close(its)
    try:
        yield Terminal(ours, process)
    finally:
        process.kill()
        process.wait()
        os.close(ours)
