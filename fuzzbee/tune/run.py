"""Runs a planned search: threads or cluster, progress, signals, checkpoint, result."""

import contextlib
import json
import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from estimator.profile import Profile, Provenance, profile_to_toml
from fuzzbee.say import say
from fuzzbee.tune.plan import Plan
from fuzzbee.tune.progress import ProgressBar
from tuning.checkpoint import (
    checkpoint_path,
    read_checkpoint,
    write_atomically,
    write_checkpoint,
)
from tuning.objective import Scores, profile_with, values_of
from tuning.optimizers import run_search
from tuning.search import Evaluate, InterruptedSearch, Record, Search
from tuning.space import encode

if TYPE_CHECKING:
    from fuzzbee.tune.view import SearchView
    from fuzzbee.viewer.stream import ViewerOptions

# A checkpoint is written this often, so a power cut costs no more of a search.
CHECKPOINT_PERIOD_S = 20.0

NAMES = {"abc": "artificial bee colony", "cmaes": "CMA-ES", "de": "differential evolution"}


class Stop:
    """Whether SIGINT or SIGTERM has asked for an end; the second signal has its usual effect."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, _frame: FrameType | None) -> None:
        """Take the signal."""
        self.asked = True
        signal.signal(number, signal.SIG_DFL)


class Outcome(NamedTuple):
    """A search that ran to its end or was interrupted, and the profile it found."""

    search: Search
    finished: bool
    profile: Profile


def run_plan(
    plan: Plan,
    *,
    threads: int | None,
    cluster: str | None,
    resume: bool,
    plot: Path | None,
    viewer: "ViewerOptions | None",
    as_json: bool,
) -> bool:
    """Search, write the profile, report. False if it was interrupted.

    Raises:
        InputError: nothing to resume, no cluster, no viewer, or a file that cannot be written.
    """
    started = time.perf_counter()
    checkpoint = checkpoint_path(plan.output)
    record = read_checkpoint(checkpoint, plan.identity) if resume else None
    if record is None and checkpoint.exists():
        _tell(f"{checkpoint}: an unfinished search, not resumed; it will be replaced")
    with contextlib.ExitStack() as stack:
        view = _open_view(viewer, plan, stack)
        with stop_signals() as stop, evaluator(plan, threads, cluster) as evaluate:
            outcome = _search(plan, evaluate, record, stop, view)
        write_atomically(plan.output, profile_to_toml(outcome.profile).encode())
        if outcome.finished:
            checkpoint.unlink(missing_ok=True)
        before, after = plan.task.score(plan.task.base), plan.task.score(outcome.profile)
        if plot is not None:
            from fuzzbee.tune.plots import draw

            draw(plot, plan.task, outcome.profile, outcome.search)
        if after.held_out > before.held_out:
            _tell(
                f"the held-out cost rose from {before.held_out:.4f} to {after.held_out:.4f}: "
                "the result fits what it was tuned on only; use more data, or keep the base"
            )
        report = _report(plan, outcome, before, after, time.perf_counter() - started)
        if as_json:
            print(json.dumps(report), flush=True)
        else:
            _print_report(report, checkpoint)
        if view is not None:
            view.finish(outcome.search, before, after)
            if outcome.finished:
                view.stream.stay_open()
    return outcome.finished


def _open_view(
    viewer: "ViewerOptions | None", plan: Plan, stack: contextlib.ExitStack
) -> "SearchView | None":
    if viewer is None:
        return None
    from fuzzbee.outputs import tell_page
    from fuzzbee.tune.view import SearchView

    view = SearchView(viewer, plan)
    stack.callback(view.close)
    tell_page(view.stream)
    return view


def _search(
    plan: Plan,
    evaluate: Evaluate,
    record: Record | None,
    stop: Stop,
    view: "SearchView | None",
) -> Outcome:
    checkpoint = checkpoint_path(plan.output)
    with ProgressBar(plan.options) as bar:
        saved_s = time.monotonic()

        def observe(search: Search) -> bool:
            nonlocal saved_s
            bar.show(search)
            if view is not None:
                view.show(search)
            now_s = time.monotonic()
            if now_s - saved_s > CHECKPOINT_PERIOD_S:
                write_checkpoint(checkpoint, plan.identity, search.record)
                saved_s = now_s
            return not stop.asked

        space = plan.task.space
        search = Search(space, plan.options, evaluate=evaluate, observe=observe, record=record)
        first = encode(space, values_of(space, plan.task.base))
        try:
            run_search(search, first)
        except InterruptedSearch:
            write_checkpoint(checkpoint, plan.identity, search.record)
            return Outcome(search, False, _profile(plan, search, finished=False))
        return Outcome(search, True, _profile(plan, search, finished=True))


def _profile(plan: Plan, search: Search, *, finished: bool) -> Profile:
    """The base profile with the values that were found, and their provenance."""
    groups = plan.identity["options"]["parameters"]
    description = f"{groups} by {NAMES[plan.options.algorithm]} against the {plan.reference}"
    if not finished:
        description += f", interrupted after {search.evaluations} of {plan.options.budget}"
    provenance = Provenance(description=description, **plan.identity)
    found = profile_with(plan.task.space, plan.task.base, search.best_values)
    return msgspec.structs.replace(found, provenance=provenance)


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """SIGINT and SIGTERM ask the search to stop, while this lasts."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # Python lets only the main thread handle signals
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def evaluator(plan: Plan, threads: int | None, cluster: str | None) -> Iterator[Evaluate]:
    """Who computes costs: this machine's threads, or a cluster's workers."""
    if cluster is not None:
        from tuning.cluster import ClusterEvaluator

        with ClusterEvaluator(cluster, plan.task.objective) as evaluate:
            yield evaluate
        return
    # Threads that wait for the next batch should sleep: spinning takes a third of a shared core.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    import numba

    before = numba.get_num_threads()
    available = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
    if threads is not None:
        if threads > available:
            _tell(f"--threads {threads}: this machine has {available}, which are used")
        numba.set_num_threads(min(threads, available))
    try:
        yield plan.task.objective.costs
    finally:
        numba.set_num_threads(before)


def _report(
    plan: Plan, outcome: Outcome, before: Scores, after: Scores, wall_s: float
) -> dict[str, Any]:
    search = outcome.search
    return {
        "evaluations": search.evaluations,
        "cycles": search.cycles,
        "food_sources": plan.options.food_sources,
        "algorithm": plan.options.algorithm,
        "parameters": plan.identity["options"]["parameters"].split(","),
        "reference": plan.reference,
        "inputs": plan.inputs,
        "cost_before": before.tuning,
        "cost_after": after.tuning,
        "held_out_before": before.held_out,
        "held_out_after": after.held_out,
        "wall_s": wall_s,
        "file": str(plan.output),
        "interrupted": not outcome.finished,
    }


def _print_report(report: dict[str, Any], checkpoint: Path) -> None:
    print(f"measured against the {report['reference']}")
    print(f"tuned on:  J {report['cost_before']:.4f} -> {report['cost_after']:.4f}")
    print(f"held out:  J {report['held_out_before']:.4f} -> {report['held_out_after']:.4f}")
    print(f"{report['evaluations']} evaluations in {report['wall_s']:.1f} s: {report['file']}")
    if report["interrupted"]:
        _tell(f"interrupted: the best so far is written; --resume goes on from {checkpoint}")


def _tell(line: str) -> None:
    say(line, "")
