"""The same work on many things, by processes beside this one or by a Dask cluster."""

import operator
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from typing import Any

from drivers.resources import Closing
from estimator.errors import InputError

# For the parent, which ends its workers: a terminal sends them to all.
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
CONNECT_TIMEOUT_S = 10.0
ATTEMPTS = 5  # to send things before a cluster is given up
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
        try:
            with _apart_from_terminal():  # all are sent at once
                answers = self._pool.map(_answer, things)
            yield from answers
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


class Cluster(Closing):
    """The workers of the Dask scheduler at ``address``, which all do the same work.

    Dask gives a dead worker's things to others; if the work itself died with the last worker that
    held it, it is sent again.

    Raises:
        InputError: no scheduler answers, or it has no workers.
    """

    def __init__(self, work: Callable[[Any], Any], address: str) -> None:
        import distributed

        try:
            self._client: Any = distributed.Client(  # type: ignore[no-untyped-call]
                address, timeout=CONNECT_TIMEOUT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"--cluster {address}: no scheduler answers: {reason}") from None
        self._address, self._work = address, work
        self._sent: Any = None  # the work on a worker, from whom the others fetch it
        self._wait_for_workers()

    def close(self) -> None:
        """Disconnect; the cluster itself keeps running."""
        self._client.close()

    def __call__(self, things: Iterable[Any]) -> list[Any]:
        """What comes of each of the things, in their order.

        Raises:
            InputError: the cluster lost all its workers, or they cannot do the work.
        """
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker

        things, submit = [*things], self._client.submit
        for _ in range(ATTEMPTS):
            try:
                if self._sent is None:
                    self._sent = self._scattered()
                futures = [submit(operator.call, self._sent, x, pure=False) for x in things]
                return list(self._client.gather(futures))
            except (FutureCancelledError, KilledWorker, OSError):
                self._sent = None
                self._wait_for_workers()
            except ImportError as error:
                raise InputError(f"--cluster {self._address}: on a worker: {error}") from None
        raise InputError(f"--cluster {self._address}: the workers keep failing")

    def _scattered(self) -> Any:
        try:
            return self._client.scatter(self._work, hash=False)
        except KeyError as worker:  # Dask no longer knows it
            raise ConnectionError(f"{worker} is gone") from None

    def _wait_for_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError:
            self.close()
            raise InputError(f"--cluster {self._address}: no workers") from None
