"""Runs a planned search: processes or a cluster, progress, signals, checkpoint, result."""

import json
import threading
import time
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from drivers.output_file import written_for
from estimator.profile import Profile, profile_to_toml
from estimator.types import Floats
from fuzzbee.notify import print_line
from fuzzbee.tune.plan import Plan
from fuzzbee.tune.report import draw, has_gained, in_words, remarks, report_of
from service.signals import stop_on_signals
from tuning.optimizers import ALGORITHMS, run_search
from tuning.processes import Cluster, Pool, available_cores
from tuning.search import Record, Search, checkpoint_path, read_checkpoint, write_checkpoint
from tuning.space import encode, profile_with, values_of

if TYPE_CHECKING:
    from fuzzbee.tune.view import SearchView

CHECKPOINT_PERIOD_S = 20.0  # a power cut costs no more of a search
NO_GAIN = 1
INTERRUPTED = 130


def run_plan(plan: Plan) -> int:
    """Search, write the profile, report; the exit status.

    On logs a profile that gains nothing on what was held out, or harms it, is written with
    ``force`` only. A finished search needs no checkpoint.
    """
    started, request, on_logs = time.perf_counter(), plan.request, not plan.request.is_simulated
    checkpoint, stop = checkpoint_path(request.output), threading.Event()
    record = read_checkpoint(checkpoint, plan.provenance) if request.resume else None
    if record is None and checkpoint.exists():
        print_line(f"{checkpoint}: an unfinished search, not resumed; it will be replaced")
    with ExitStack() as stack:
        view = None
        if request.view is not None or request.rrd is not None:
            from fuzzbee.tune.view import SearchView

            view = SearchView(plan.task.space, request.view, request.rrd)
            stack.enter_context(closing(view))
        with stop_on_signals(stop.set):
            search, is_finished, by_chance = _run(plan, record, stop, view)
            found = _found(plan, search, is_finished=is_finished)
            report = report_of(plan, search, found, by_chance)
        gained = has_gained(report["held_out_before"], report["held_out_after"], report.get("harm"))
        is_written = gained or request.force or not on_logs
        if is_written:
            with written_for("--output", request.output) as fresh:
                fresh.write_bytes(profile_to_toml(found).encode())
        if is_finished:
            checkpoint.unlink(missing_ok=True)
        if request.plot is not None:
            draw(request.plot, plan, found, search)
        report |= {
            "wall_s": time.perf_counter() - started,
            "interrupted": not is_finished,
            "file": str(request.output) if is_written else None,
        }
        print(json.dumps(report) if request.as_json else in_words(plan, search, report), flush=True)
        for line in remarks(request.output, report, on_logs=on_logs):
            print_line(line)
        if view is not None:
            view.show_end(search, stay=is_finished)
    if not is_finished:
        return INTERRUPTED
    return 0 if is_written else NO_GAIN


def _run(
    plan: Plan, record: Record | None, stop: threading.Event, view: "SearchView | None"
) -> tuple[Search, bool, Profile | None]:
    """Search until the budget is spent or somebody stops it; the checkpoint is written then.

    Returns the search, whether it came to its end, and on logs what random search finds. A line
    shows how far it is where standard error is a terminal.
    """
    task, request, options = plan.task, plan.request, plan.options
    checkpoint, saved_s = checkpoint_path(request.output), time.monotonic()
    console = Console(stderr=True)
    name, count = TextColumn("{task.description}, evaluations"), MofNCompleteColumn()
    columns = (name, BarColumn(20), count, TimeRemainingColumn())
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    line = bar.add_task(options.algorithm, total=options.budget)
    cores = request.threads or available_cores()
    pool = Cluster(task.costs, request.cluster) if request.cluster else Pool(task.costs, cores)
    with pool, bar:

        def evaluate(values: Floats) -> Floats:
            return np.concatenate([*pool(task.batches(values))])

        def observe(search: Search) -> bool:
            nonlocal saved_s
            words = f"{options.algorithm}, best cost {search.best_cost:.4f}"
            bar.update(line, completed=search.evaluations, description=words)
            if view is not None:
                view.show(search)
            if time.monotonic() - saved_s > CHECKPOINT_PERIOD_S or stop.is_set():
                write_checkpoint(checkpoint, plan.provenance, search.record)
                saved_s = time.monotonic()
            return not stop.is_set()

        search = Search(task.space, options, evaluate, observe, record)
        first = encode(task.space, values_of(task.space, task.base))
        is_finished, by_chance = run_search(search, first), None
        if is_finished and not request.is_simulated:
            options = options._replace(algorithm="random")
            random_search = Search(task.space, options, evaluate, lambda _: not stop.is_set())
            if run_search(random_search, first):  # the result stands without it
                by_chance = profile_with(task.space, task.base, random_search.best_values)
    return search, is_finished, by_chance


def _found(plan: Plan, search: Search, *, is_finished: bool) -> Profile:
    """The base profile with the best values so far, and their provenance."""
    groups = ",".join(plan.task.groups)
    description = (
        f"{groups} by {ALGORITHMS[plan.options.algorithm].name} against the {plan.reference}"
    )
    if not is_finished:
        description += f", interrupted after {search.evaluations} of {plan.options.budget}"
    best = profile_with(plan.task.space, plan.task.base, search.best_values)
    provenance = replace(plan.provenance, description=description)
    return replace(best, provenance=provenance)
