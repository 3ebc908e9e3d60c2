"""Python processes beside this one that answer pickled questions, over their standard streams."""

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any

from drivers.closing import Closing

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


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pool(Closing):
    """``count`` processes that do the same work; with one the calling process does it.

    The work, what it takes and what comes of it are pickled. (The standard library's pools start
    their processes by a fork, which copies the locks of numba's threads as they stand, or run
    the main program once more.)
    """

    def __init__(self, work: Callable[[Any], Any], count: int) -> None:
        self._work = work
        self._processes = [start(__name__) for _ in range(count if count > 1 else 0)]
        self._free: SimpleQueue[subprocess.Popen[bytes]] = SimpleQueue()
        for process in self._processes:
            send(process, work)
            self._free.put(process)
        self._threads = ThreadPoolExecutor(max(count, 1))

    def __call__(self, things: Iterable[Any]) -> Iterator[Any]:
        """What comes of each of the things, in their order."""
        if not self._processes:
            return map(self._work, things)
        return self._threads.map(self._ask, things)

    def close(self) -> None:
        """End the processes, whatever they are at."""
        for process in self._processes:
            process.kill()
        self._threads.shutdown(cancel_futures=True)
        for process in self._processes:
            process.communicate()
        self._processes = []

    def _ask(self, thing: Any) -> Any:
        process = self._free.get()
        try:
            send(process, thing)
            return receive(process)
        except (BrokenPipeError, EOFError):
            raise ChildProcessError(f"process {process.pid}, which computed, has ended") from None
        finally:
            self._free.put(process)


def serve() -> None:
    """A process of a pool: work from its parent, then things; answers with what comes of them."""
    questions, answer = channel()
    for work in questions:  # the first of them, if the parent has lived so long
        for thing in questions:
            answer(work(thing))
