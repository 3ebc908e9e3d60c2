"""The paper's figures, before and after tuning: ``tune --plot DIR``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.output_file import written_whole
from estimator.errors import InputError
from estimator.filter.memberships import TERMS, Triangle, fuzzy_sets
from estimator.geometry.metrics import COST_RATE_HZ, batch_angle_errors
from estimator.profile import Profile
from fuzzbee.angle_curves import draw_angles
from tuning.flight import fly
from tuning.log_task import LogTask
from tuning.paper_experiment import run_experiment
from tuning.paper_task import PaperTask
from tuning.search import Search

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# Fixed gains to compare with, as in the paper: the steadiest, the quickest, and one between.
FIXED_GAINS = (1.0, 10.0, 100.0)
DOTS_PER_INCH = 150
ESTIMATED = {"color": "C1", "ls": "--"}
MOST_FLIGHTS = 6  # in one figure


def draw(folder: Path, task: PaperTask | LogTask, tuned: Profile, search: Search) -> list[Path]:
    """Draw what the task allows into ``folder`` as PNG files; returns their paths.

    Raises:
        InputError: the folder cannot be made or written to.
    """
    figures = {"convergence": convergence(search)}
    if "k1" in task.space.names:
        figures["memberships"] = memberships(task.base, tuned)
    if isinstance(task, PaperTask):
        seed = task.held_out_seeds[0]
        figures["error"] = error_over_time(task.base, tuned, seed)
        figures["euler"] = euler_angles(tuned, seed)
    else:
        figures["error"] = error_on_logs(task, tuned)
    return [_save(figure, folder / f"{name}.png") for name, figure in figures.items()]


def _save(figure: "Figure", path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as fresh:
            figure.savefig(fresh, dpi=DOTS_PER_INCH)
    except OSError as error:
        raise InputError(f"--plot {path.parent}: {error.strerror}") from None
    return path


def _figure(rows: int, columns: int, width: float, height: float) -> tuple["Figure", Any]:
    """A figure that needs no screen."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def convergence(search: Search) -> "Figure":
    """Best and mean cost of the population over the evaluations."""
    figure, axes = _figure(1, 1, 7.0, 4.0)
    ax = axes[0, 0]
    evaluations = [p.evaluations for p in search.history]
    ax.plot(evaluations, [p.mean_cost for p in search.history], label="mean of the population")
    ax.plot(evaluations, [p.best_cost for p in search.history], label="best so far")
    ax.set(xlabel="evaluations", ylabel="cost J", title="Convergence of the search")
    ax.grid(visible=True, alpha=0.3)
    ax.legend()
    return figure


def memberships(before: Profile, after: Profile) -> "Figure":
    """Input and output sets, before and after."""
    figure, axes = _figure(2, 2, 10.0, 6.0)
    for row, (name, profile) in enumerate((("before", before), ("after", after))):
        sets = fuzzy_sets(profile.k)
        _triangles(axes[row, 0], sets.inputs)
        axes[row, 0].set(title=f"Error and rate of error, {name}", xlabel="e, |de/dt| in 1/s")
        _triangles(axes[row, 1], sets.output)
        axes[row, 1].set(title=f"Output, {name}", xlabel="k_op")
        for ax in axes[row]:
            ax.set(ylabel="membership", ylim=(0.0, 1.15))
    return figure


def _triangles(ax: Any, sets: tuple[Triangle, ...]) -> None:
    for i, (term, corners) in enumerate(zip(TERMS, sets, strict=True)):
        colour = f"C{i}"
        ax.plot(corners, (0.0, 1.0, 0.0), color=colour)
        ax.fill_between(corners, (0.0, 1.0, 0.0), color=colour, alpha=0.15)
        ax.annotate(term, (corners[1], 1.03), color=colour, ha="center")


def error_over_time(before: Profile, after: Profile, seed: int) -> "Figure":
    """e(R~) on a noise seed that the search has not seen, against fixed gains."""
    figure, axes = _figure(1, 2, 11.0, 4.2)
    runs = [(f"K = {gain:g}", run_experiment(after, seed, gain), "-") for gain in FIXED_GAINS]
    runs.append(("fuzzy, before", run_experiment(before, seed), ":"))
    runs.append(("fuzzy, tuned", run_experiment(after, seed), "-"))
    time_s = np.arange(len(runs[0][1].true_error)) / COST_RATE_HZ
    for ax, end_s in zip(axes[0], (1.0, time_s[-1]), strict=True):
        for name, run, style in runs:
            shown = time_s <= end_s
            width = 2.0 if name == "fuzzy, tuned" else 1.0
            ax.plot(time_s[shown], run.true_error[shown], style, label=name, linewidth=width)
        ax.set(xlabel="time in s", ylabel="e(R~)", yscale="log", ylim=(1e-5, 1.5))
        ax.grid(visible=True, alpha=0.3)
    axes[0, 0].set_title("Normalised Euclidean distance, the first second")
    axes[0, 1].set_title(f"the whole experiment (noise seed {seed})")
    axes[0, 1].legend(loc="upper right", fontsize="small")
    return figure


def error_on_logs(task: LogTask, tuned: Profile) -> "Figure":
    """Inclination error over time on the held-out flights, before and after."""
    parts = task.split.held_out[:MOST_FLIGHTS]
    figure, axes = _figure(len(parts), 1, 11.0, 1.0 + 2.4 * len(parts))
    for ax, part in zip(axes[:, 0], parts, strict=True):
        flight, known = part.flight, part.flight.known[part.window]
        time_s = flight.time_s[part.window][known]
        for name, profile, colour in (("before", task.base, "C0"), ("tuned", tuned, "C1")):
            course = fly(flight, profile, part.last)
            errors = batch_angle_errors(course.q_ned_frd[part.window], flight.truth[part.window])
            ax.plot(time_s, np.degrees(errors[known, 2]), color=colour, linewidth=0.9, label=name)
        ax.set(title=flight.name, ylabel="inclination error in deg", xlabel="time in s")
        ax.grid(visible=True, alpha=0.3)
        ax.legend(loc="upper right")
    return figure


def euler_angles(tuned: Profile, seed: int) -> "Figure":
    """Roll, pitch and yaw, true and estimated."""
    figure, axes = _figure(3, 1, 8.0, 7.0)
    run = run_experiment(tuned, seed)
    time_s = np.arange(len(run.true_error)) / COST_RATE_HZ
    true, estimated = (run.truth, {"color": "k"}, "true"), (run.estimates, ESTIMATED, "estimated")
    draw_angles(axes[:, 0], time_s, (true, estimated))
    for ax in axes[:, 0]:
        ax.grid(visible=True, alpha=0.3)
    axes[0, 0].set_title(f"Euler angles (noise seed {seed})")
    axes[0, 0].legend(loc="upper right")
    axes[2, 0].set_xlabel("time in s")
    return figure
