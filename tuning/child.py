"""A Python process beside this one that answers pickled questions, over its standard streams."""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

# What it runs: our own modules, from wherever this process has them, and nothing from the folder
# that the command was started in: -P keeps that off the path.
PROGRAM = "import sys; sys.path[:] = {path!r}; from {module} import serve; serve()"


# For the parent, which says what is to end: a terminal sends them to all.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def start(module: str) -> subprocess.Popen[bytes]:
    """A process that runs ``serve`` of one of our modules."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # until it ignores them
    try:
        return subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-P", "-c", PROGRAM.format(path=sys.path, module=module)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def send(process: subprocess.Popen[bytes], question: object) -> None:
    """Ask it."""
    assert process.stdin is not None
    pickle.dump(question, process.stdin)
    process.stdin.flush()


def receive(process: subprocess.Popen[bytes]) -> Any:
    """Wait for its next answer.

    Raises:
        EOFError: it has ended.
    """
    assert process.stdout is not None
    return pickle.load(process.stdout)  # noqa: S301 - of our own process


def channel() -> tuple[Iterator[Any], Callable[[object], None]]:
    """In the process itself: its questions until the parent closes the pipe, and how to answer."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # a stray print must not look like an answer

    def answer(value: object) -> None:
        try:
            pickle.dump(value, answers)
            answers.flush()
        except BrokenPipeError:  # whoever asked was killed
            os._exit(0)

    return _questions(), answer


def _questions() -> Iterator[Any]:
    while True:
        try:
            yield pickle.load(sys.stdin.buffer)  # noqa: S301 - of the process that started this
        except (EOFError, pickle.UnpicklingError):  # of a parent that was killed, maybe half of one
            return
