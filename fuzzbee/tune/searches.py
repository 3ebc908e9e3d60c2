"""The searches of one run: on a cluster or on cores, with progress bars and one checkpoint."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from estimator.profile import Profile
from fuzzbee.tune.plan import Plan
from fuzzbee.tune.progress import ProgressBar
from fuzzbee.tune.request import TuneRequest
from tuning.checkpoint import checkpoint_path, write_checkpoint
from tuning.child import Pool, available_cores
from tuning.log_task import LogTask
from tuning.objective import one_cost, profile_with, values_of
from tuning.optimizers import run_search
from tuning.paper_task import PaperTask
from tuning.search import Evaluate, InterruptedSearch, Record, Search
from tuning.space import encode

# A checkpoint is written this often, so a power cut costs no more of a search.
CHECKPOINT_PERIOD_S = 20.0

Task = PaperTask | LogTask
Watch = Callable[[Search], None]


class Searches:
    """The searches that a plan needs, one behind the other, until ``stop`` is set.

    ``earlier`` are the records of an unfinished run. ``latest`` is the search that is under way, or
    was interrupted.
    """

    latest: Search

    def __init__(
        self, plan: Plan, request: TuneRequest, stop: threading.Event, earlier: list[Record]
    ) -> None:
        self._plan = plan
        self._request = request
        self._stop = stop
        self._earlier = earlier
        self._done: list[Record] = []

    def found(self, task: LogTask) -> Profile:
        """What a search finds.

        Raises:
            InterruptedSearch: it was stopped.
        """
        with self.evaluator(task) as evaluate:
            return best(task, self.run(task, evaluate))

    def run(self, task: Task, evaluate: Evaluate, watch: Watch | None = None) -> Search:
        """A search that has ended.

        Raises:
            InterruptedSearch: it was stopped; the checkpoint is written.
        """
        with ProgressBar(self._plan.options) as bar:
            saved_s = time.monotonic()

            def observe(search: Search) -> bool:
                nonlocal saved_s
                bar.show(search)
                if watch is not None:
                    watch(search)
                now_s = time.monotonic()
                if now_s - saved_s > CHECKPOINT_PERIOD_S:
                    self._save()
                    saved_s = now_s
                return not self._stop.is_set()

            place = len(self._done)
            record = self._earlier[place] if place < len(self._earlier) else None
            self.latest = search = Search(
                task.space, self._plan.options, evaluate=evaluate, observe=observe, record=record
            )
            try:
                run_from_base(search, task)
            except InterruptedSearch:
                self._save()
                raise
            self._done.append(search.record)
            return search

    def by_chance(self, task: Task, evaluate: Evaluate) -> Profile | None:
        """What random search finds with the same budget; None if it was stopped."""
        options = self._plan.options._replace(algorithm="random")
        search = Search(task.space, options, evaluate, observe=lambda _: not self._stop.is_set())
        with contextlib.suppress(InterruptedSearch):  # the result stands without it
            run_from_base(search, task)
            return best(task, search)
        return None

    @contextlib.contextmanager
    def evaluator(self, task: Task) -> Iterator[Evaluate]:
        """Choose what computes costs: a cluster, or processes here."""
        objective, threads = task.objective, self._request.threads
        if self._request.cluster is not None:
            from tuning.cluster import ClusterEvaluator

            with ClusterEvaluator(self._request.cluster, objective) as evaluate:
                yield evaluate
        else:
            work = partial(one_cost, objective)
            with Pool(work, available_cores() if threads is None else threads) as pool:
                yield lambda values: np.array([*pool(values)])

    def _save(self) -> None:
        path = checkpoint_path(self._plan.output)
        write_checkpoint(path, self._plan.identity, [*self._done, self.latest.record])


def run_from_base(search: Search, task: Task) -> None:
    """Run a search that begins with the base profile's values."""
    run_search(search, encode(task.space, values_of(task.space, task.base)))


def best(task: Task, search: Search) -> Profile:
    """The base profile with the best values so far."""
    return profile_with(task.space, task.base, search.best_values)
