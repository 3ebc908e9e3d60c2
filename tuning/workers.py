"""Costs computed by several processes of this machine."""

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue

import numpy as np

from drivers.closing import Closing
from estimator.arrays import Floats
from tuning import child
from tuning.objective import Objective


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
        self._processes = [child.start(__name__) for _ in range(count if count > 1 else 0)]
        self._free: SimpleQueue[subprocess.Popen[bytes]] = SimpleQueue()
        for process in self._processes:
            child.send(process, objective)
            self._free.put(process)
        self._threads = ThreadPoolExecutor(max(count, 1))

    def __call__(self, values: Floats) -> Floats:
        """Costs (C,) of parameter values (C, D)."""
        if not self._processes:
            return self._objective.costs(values)
        return np.array(list(self._threads.map(self._ask, values)))

    def close(self) -> None:
        """End the processes."""
        self._threads.shutdown(cancel_futures=True)
        for process in self._processes:
            process.kill()
            process.communicate()
        self._processes = []

    def _ask(self, row: Floats) -> float:
        process = self._free.get()
        try:
            child.send(process, row)
            return float(child.receive(process))
        except (BrokenPipeError, EOFError):
            raise ChildProcessError(f"process {process.pid}, which computed, has ended") from None
        finally:
            self._free.put(process)


def serve() -> None:
    """A worker: an objective from its parent, then rows of values; answers with their costs."""
    questions, answer = child.channel()
    for objective in questions:  # the first of them, if the parent has lived so long
        for row in questions:
            answer(float(objective.costs(row[None, :])[0]))
