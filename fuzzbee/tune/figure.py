"""A search in one figure: ``tune --plot DIR``."""

from pathlib import Path
from typing import Any

import numpy as np

from estimator.errors import InputError
from estimator.filter.memberships import fuzzy_sets
from estimator.geometry.metrics import COST_RATE_HZ, batch_angle_errors
from estimator.profile import Profile
from fuzzbee.replays.figure import add_legend, draw_sets, written_figure
from fuzzbee.tune.plan import Plan
from tuning.flight import Flight, fly
from tuning.paper_experiment import run_experiment
from tuning.search import Search

NAME = "tuning.png"
# Fixed gains to compare with, as in the paper: the steadiest, the quickest, and one between.
FIXED_GAINS = (1.0, 10.0, 100.0)
WIDTH_IN, HEIGHT_IN = 10.0, 2.8  # of a panel
MOST_FLIGHTS = 6


def draw(folder: Path, plan: Plan, tuned: Profile, search: Search) -> None:
    """Draw into ``folder`` how the search went, and what its result changes where it never was."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--plot {folder}: {error.strerror}") from None
    task, is_simulated = plan.task, plan.request.is_simulated
    flights = () if is_simulated else task.held_out[:MOST_FLIGHTS]
    panels = 1 + is_simulated + len(flights) + 2 * task.tunes_memberships
    with written_figure(folder / NAME, "", (WIDTH_IN, HEIGHT_IN * panels)) as sheet:
        first, *axes = sheet.subplots(panels, squeeze=False)[:, 0]
        evaluations, history = [p.evaluations for p in search.history], search.history
        first.plot(evaluations, [p.mean_cost for p in history], label="mean of the population")
        first.plot(evaluations, [p.best_cost for p in history], label="best so far")
        first.set(xlabel="evaluations", ylabel="cost J", title="Convergence of the search")
        add_legend(first, 2)
        if is_simulated:
            _draw_error_over_time(axes[0], task.held_out[0], plan.before, tuned)
        for ax, flight in zip(axes, flights, strict=False):
            _draw_error_on_log(ax, flight, plan.before, tuned)
        if task.tunes_memberships:
            before, after = fuzzy_sets(plan.before.k), fuzzy_sets(tuned.k)
            draw_sets(axes[-2], "e, |de/dt| in 1/s", after.inputs, before.inputs)
            draw_sets(axes[-1], "k_op", after.output, before.output)
            axes[-2].set_title("Fuzzy sets, dotted: before")


def _draw_error_over_time(axes: Any, seed: int, before: Profile, tuned: Profile) -> None:
    """e(R~) on a noise seed that the search has not seen, against fixed gains."""
    runs = {f"K = {gain:g}": run_experiment(tuned, seed, gain) for gain in FIXED_GAINS}
    runs |= {"fuzzy, before": run_experiment(before, seed)}
    runs |= {"fuzzy, tuned": run_experiment(tuned, seed)}
    for name, run in runs.items():
        time_s = np.arange(1, len(run.true_error) + 1) / COST_RATE_HZ
        axes.plot(time_s, run.true_error, label=name, linewidth=2.0 if "tuned" in name else 0.8)
    axes.set(xlabel="time in s, from 0.01 s on", ylabel="e(R~)", xscale="log", yscale="log")
    axes.set(ylim=(1e-5, 1.5), title=f"Normalised Euclidean distance (noise seed {seed})")
    add_legend(axes, len(runs))


def _draw_error_on_log(axes: Any, flight: Flight, before: Profile, tuned: Profile) -> None:
    """Inclination error over time on a held-out flight, before and after."""
    known = flight.known[flight.window]
    for name, profile in (("before", before), ("tuned", tuned)):
        course = fly(flight, profile)
        errors = batch_angle_errors(course.q_ned_frd[flight.window], flight.truth[flight.window])
        time_s = flight.time_s[flight.window][known]
        axes.plot(time_s, np.degrees(errors[known, 2]), linewidth=0.9, label=name)
    axes.set(title=flight.name, ylabel="inclination error in deg", xlabel="time in s")
    add_legend(axes, 2)
