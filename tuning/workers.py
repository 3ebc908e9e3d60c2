"""Costs computed by several processes of this machine, for objectives that run in plain Python."""

import os
import pickle
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from typing import IO, Any

import numpy as np

from drivers.closing import Closing
from tuning.arrays import Array
from tuning.objective import Objective

# What a worker runs: our own modules, from wherever this process has them.
PROGRAM = f"import sys; sys.path[:] = {{path!r}}; from {__name__} import serve; serve()"


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Workers(Closing):
    """``count`` processes with an objective each; with one the calling process computes.

    Who computes a candidate has no influence on its cost. (The standard library's pools start
    their processes by a fork, which copies the locks of numba's threads as they stand, or run
    the main program once more.)
    """

    def __init__(self, objective: Objective, count: int) -> None:
        self._objective = objective
        self._processes = [_start(objective) for _ in range(count if count > 1 else 0)]
        self._free: SimpleQueue[subprocess.Popen[bytes]] = SimpleQueue()
        for process in self._processes:
            self._free.put(process)
        self._threads = ThreadPoolExecutor(max(count, 1))

    def __call__(self, values: Array) -> Array:
        """Costs (C,) of parameter values (C, D)."""
        if not self._processes:
            return self._objective.serial_costs(values)
        return np.array(list(self._threads.map(self._ask, values)))

    def close(self) -> None:
        """End the processes."""
        self._threads.shutdown(cancel_futures=True)
        for process in self._processes:
            process.kill()
            process.communicate()
        self._processes = []

    def _ask(self, row: Array) -> float:
        process = self._free.get()
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            _send(process.stdin, row)
            return float(pickle.load(process.stdout))  # noqa: S301 - of our own process
        finally:
            self._free.put(process)


def _start(objective: Objective) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(  # noqa: S603 - our own program
        [sys.executable, "-P", "-c", PROGRAM.format(path=sys.path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdin is not None
    _send(process.stdin, objective)
    return process


def _send(pipe: IO[bytes], value: Any) -> None:
    pickle.dump(value, pipe)
    pipe.flush()


def serve() -> None:
    """A worker: an objective from standard input, then rows of values; costs to standard output.

    Ctrl-C is for the search, which ends its workers.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # a stray print must not look like a cost
    objective: Objective = pickle.load(questions)  # noqa: S301 - of the process that started this
    while True:
        try:
            row = pickle.load(questions)  # noqa: S301 - likewise
        except EOFError:
            return
        _send(answers, float(objective.serial_costs(row[None, :])[0]))
