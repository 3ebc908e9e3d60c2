"""Evaluation on a Dask cluster, chunk by chunk, with the same results as here.

Which worker computes a chunk, and how the batch is cut, has no influence on
the costs. Dask gives a dead worker's chunks to others; if the prepared data
died with the last worker that held it, it is sent again.
"""

from typing import Any

import numpy as np

from drivers.closing import Closing
from estimator.arrays import Floats
from estimator.errors import InputError, missing_extra
from tuning.task import Task, batches

CONNECT_TIMEOUT_S = 10.0
# A batch is sent again this often before the cluster is given up.
ATTEMPTS = 5


class ClusterEvaluator(Closing):
    """Costs of candidates, computed by the workers of the scheduler at ``address``.

    Raises:
        InputError: dask.distributed is not installed, no scheduler answers, or
            it has no workers.
    """

    def __init__(self, address: str, task: Task) -> None:
        try:
            import distributed
        except ImportError:
            raise missing_extra("--cluster", "cluster") from None
        try:
            self._client: Any = distributed.Client(  # type: ignore[no-untyped-call]
                address, timeout=CONNECT_TIMEOUT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"--cluster {address}: no scheduler answers: {reason}") from None
        self._address = address
        self._task = task
        self._sent: Any = None
        self._wait_for_workers()

    def close(self) -> None:
        """Disconnect; the cluster itself keeps running."""
        self._client.close()

    def __call__(self, values: Floats) -> Floats:
        """Costs (C,) of parameter values (C, D).

        Raises:
            InputError: the cluster lost all its workers, or they cannot run the task.
        """
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker

        for _ in range(ATTEMPTS):
            try:
                if self._sent is None:
                    self._sent = self._client.scatter(self._task, broadcast=True, hash=False)
                costs, parts = type(self._task).costs, batches(self._task, values)
                futures = [self._client.submit(costs, self._sent, x, pure=False) for x in parts]
                return np.concatenate(self._client.gather(futures))
            except (FutureCancelledError, KilledWorker, OSError):
                self._sent = None
                self._wait_for_workers()
            except ImportError as error:
                raise InputError(f"--cluster {self._address}: on a worker: {error}") from None
        raise InputError(f"--cluster {self._address}: the workers keep failing")

    def _wait_for_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError:
            self.close()
            raise InputError(f"--cluster {self._address}: no workers") from None
