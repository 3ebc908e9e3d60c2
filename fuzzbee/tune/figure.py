"""A search in one figure: ``tune --plot DIR``."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.output_file import written_whole
from estimator.errors import InputError
from estimator.filter.memberships import TERMS, Triangle, fuzzy_sets
from estimator.geometry.metrics import COST_RATE_HZ, batch_angle_errors
from estimator.profile import Profile
from tuning.flight import Flight, fly
from tuning.paper_experiment import run_experiment
from tuning.search import Search
from tuning.task import PaperTask, Task

NAME = "tuning.png"
# Fixed gains to compare with, as in the paper: the steadiest, the quickest, and one between.
FIXED_GAINS = (1.0, 10.0, 100.0)
DOTS_PER_INCH = 150
WIDTH_IN, HEIGHT_IN = 10.0, 2.8  # of a panel
MOST_FLIGHTS = 6

Panel = Callable[[Any], None]


def draw(folder: Path, task: Task, tuned: Profile, search: Search) -> None:
    """Draw into ``folder`` how the search went, and what its result changes where it never was."""
    from matplotlib.figure import Figure

    panels: list[Panel] = [partial(_convergence, search)]
    if isinstance(task, PaperTask):
        panels.append(partial(_error_over_time, task, tuned))
    else:
        panels += [
            partial(_error_on_log, task, tuned, flight) for flight in task.held_out[:MOST_FLIGHTS]
        ]
    if task.tunes_memberships:
        before, after = fuzzy_sets(task.base.k), fuzzy_sets(tuned.k)
        panels.append(partial(_sets, "e, |de/dt| in 1/s", before.inputs, after.inputs))
        panels.append(partial(_sets, "k_op", before.output, after.output))
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN * len(panels)), layout="constrained")
    for panel, axes in zip(panels, figure.subplots(len(panels), squeeze=False)[:, 0], strict=True):
        panel(axes)
        axes.grid(visible=True, alpha=0.3)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with written_whole(folder / NAME) as fresh:
            figure.savefig(fresh, dpi=DOTS_PER_INCH)
    except OSError as error:
        raise InputError(f"--plot {folder}: {error.strerror}") from None


def _convergence(search: Search, axes: Any) -> None:
    """Best and mean cost of the population over the evaluations."""
    evaluations = [p.evaluations for p in search.history]
    axes.plot(evaluations, [p.mean_cost for p in search.history], label="mean of the population")
    axes.plot(evaluations, [p.best_cost for p in search.history], label="best so far")
    axes.set(xlabel="evaluations", ylabel="cost J", title="Convergence of the search")


def _error_over_time(task: PaperTask, tuned: Profile, axes: Any) -> None:
    """e(R~) on a noise seed that the search has not seen, against fixed gains."""
    seed = task.held_out[0]
    runs = {f"K = {gain:g}": run_experiment(tuned, seed, gain) for gain in FIXED_GAINS}
    runs |= {"fuzzy, before": run_experiment(task.base, seed)}
    runs |= {"fuzzy, tuned": run_experiment(tuned, seed)}
    for name, run in runs.items():
        time_s = np.arange(1, len(run.true_error) + 1) / COST_RATE_HZ
        axes.plot(time_s, run.true_error, label=name, linewidth=2.0 if "tuned" in name else 0.8)
    axes.set(xlabel="time in s, from 0.01 s on", ylabel="e(R~)", xscale="log", yscale="log")
    axes.set(ylim=(1e-5, 1.5), title=f"Normalised Euclidean distance (noise seed {seed})")


def _error_on_log(task: Task, tuned: Profile, flight: Flight, axes: Any) -> None:
    """Inclination error over time on a held-out flight, before and after."""
    known = flight.known[flight.window]
    for name, profile in (("before", task.before), ("tuned", tuned)):
        course = fly(flight, profile)
        errors = batch_angle_errors(course.q_ned_frd[flight.window], flight.truth[flight.window])
        time_s = flight.time_s[flight.window][known]
        axes.plot(time_s, np.degrees(errors[known, 2]), linewidth=0.9, label=name)
    axes.set(title=flight.name, ylabel="inclination error in deg", xlabel="time in s")


def _sets(name: str, before: tuple[Triangle, ...], after: tuple[Triangle, ...], axes: Any) -> None:
    """Fuzzy sets, before (dotted) and after."""
    for i, (term, old, new) in enumerate(zip(TERMS, before, after, strict=True)):
        axes.plot(old, (0.0, 1.0, 0.0), color=f"C{i}", linestyle=":")
        axes.plot(new, (0.0, 1.0, 0.0), color=f"C{i}", label=term)
        axes.fill_between(new, (0.0, 1.0, 0.0), color=f"C{i}", alpha=0.15)
    axes.set(xlabel=name, ylabel="membership", title="Fuzzy sets, dotted: before")
