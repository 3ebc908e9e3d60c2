"""The same work on many things, by processes beside this one."""

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from typing import Any

from drivers.closing import Closing

# For the parent, which ends its workers: a terminal sends them to all.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_work: Callable[[Any], Any]  # of a process that has been started here


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Pool(Closing):
    """``count`` processes that do the same work; with one the calling process does it.

    The work, what it takes and what comes of it are pickled. Processes are spawned, because a fork
    copies the locks of numba's threads as they stand.
    """

    def __init__(self, work: Callable[[Any], Any], count: int) -> None:
        self._work = work
        self._pool: ProcessPoolExecutor | None = None
        # where /dev/shm is read-only there are no semaphores to share
        with suppress(OSError), _apart_from_terminal():  # the library starts a process here
            if count > 1:
                self._pool = ProcessPoolExecutor(count, get_context("spawn"), _begin, (work,))

    def __call__(self, things: Iterable[Any]) -> Iterator[Any]:
        """What comes of each of the things, in their order.

        Raises:
            ChildProcessError: a process has ended, such as by the system for want of memory.
        """
        if self._pool is None:
            yield from map(self._work, things)
            return
        with _apart_from_terminal():
            answers = [self._pool.submit(_answer, thing) for thing in things]
        try:
            for answer in answers:
                yield answer.result()
        except BrokenProcessPool:
            raise ChildProcessError("a process, which computed, has ended") from None

    def close(self) -> None:
        """End the processes, whatever they are at."""
        if self._pool is not None:
            started = self._pool._processes  # noqa: SLF001 - no other way before Python 3.14
            for process in [*(started or {}).values()]:
                process.kill()
            self._pool.shutdown(cancel_futures=True)


@contextmanager
def _apart_from_terminal() -> Iterator[None]:
    """Have processes start with signals blocked, and without modules of the present folder."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    path = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if path is None:
            del os.environ["PYTHONSAFEPATH"]
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(work: Callable[[Any], Any]) -> None:
    global _work  # noqa: PLW0603 - sent once, as it holds whole recordings
    _work = work
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End when the parent does: one that was killed cannot end us."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _answer(thing: Any) -> Any:
    return _work(thing)
