"""The paper's experiment in files: every sample as CSV, the paper's figures to print."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from estimator.arrays import Floats
from estimator.geometry.metrics import COST_RATE_HZ, batch_angle_errors
from fuzzbee.angle_curves import draw_angles
from fuzzbee.replays.exports import write_rows
from fuzzbee.replays.plot import STYLE, legend_above, save, title_lines
from tuning.paper_experiment import SETTLED_ERROR, ExperimentResult

Results = Sequence[ExperimentResult]

COLUMNS = (
    *("seed", "time_s", "error", "gain"),
    *("q_w", "q_x", "q_y", "q_z"),
    *("reference_q_w", "reference_q_x", "reference_q_y", "reference_q_z"),
    *("error_total_deg", "error_heading_deg", "error_inclination_deg"),
)
FIGURE_INCHES = (7.1, 7.6)  # the width of a page's text
TRANSIENT_S = 1.0
# What is drawn of the seeds: the middle one, the middle half, nine in ten.
MEDIAN, BANDS = 50.0, ((5.0, 95.0, 0.18), (25.0, 75.0, 0.35))
LEAST_SHOWN_ERROR = 1e-5


def write_csv(path: Path, seeds: Sequence[int], results: Results) -> None:
    """A row for every sample of every seed, in the order of :data:`COLUMNS`.

    ``error`` is the true e, sin^2 of half the error's angle, and the quaternion is the estimate
    before the sample's correction; ``gain`` is the correction's. Nine significant digits.

    Raises:
        InputError: the file cannot be written.
    """
    each = zip(seeds, results, strict=True)
    write_rows(path, COLUMNS, (row for seed, result in each for row in _rows(seed, result)))


def _rows(seed: int, result: ExperimentResult) -> Iterator[list[float]]:
    angles = np.degrees(batch_angle_errors(result.estimates, result.truth))
    time_s = np.arange(len(angles)) / COST_RATE_HZ
    columns = (time_s, result.true_error, result.gains, result.estimates, result.truth, angles)
    for row in np.column_stack(columns).tolist():
        yield [seed, *row]


def draw(path: Path, title: str, seeds: Sequence[int], results: Results) -> None:
    """The paper's figures: e and K over time, median and bands of the seeds; one seed's angles.

    Raises:
        InputError: the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    time_s = np.arange(len(results[0].true_error)) / COST_RATE_HZ
    quantities = (
        ("$e(\\tilde R)$", np.array([r.true_error for r in results])),
        ("gain $K$", np.array([r.gains for r in results])),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
        halves: Any = figure.add_gridspec(2, 1, height_ratios=(1.25, 1.0))
        figure.suptitle(title_lines(title))
        grid = halves[0].subgridspec(2, 2, width_ratios=(1.0, 1.6))
        axes: Any = grid.subplots(sharey="row")
        for row, (name, values) in zip(axes, quantities, strict=True):
            row[0].set_ylabel(name)
            for ax, end_s in zip(row, (TRANSIENT_S, time_s[-1]), strict=True):
                _band(ax, time_s, values, end_s)
        _finish(axes, time_s[-1])
        _angles(halves[1].subgridspec(3, 1).subplots(sharex=True), time_s, seeds[0], results[0])
        save(figure, path)


def _band(ax: Any, time_s: Floats, values: Floats, end_s: float) -> None:
    """Median and bands of (seeds, N) up to ``end_s``."""
    shown = time_s <= end_s
    if len(values) > 1:
        for low, high, alpha in BANDS:
            edges = np.percentile(values[:, shown], (low, high), axis=0)
            label = f"{low:g} to {high:g} %"
            ax.fill_between(time_s[shown], *edges, color="C0", alpha=alpha, lw=0, label=label)
    middle = np.percentile(values[:, shown], MEDIAN, axis=0)
    legend = {"label": "median of the seeds"} if len(values) > 1 else {}
    ax.plot(time_s[shown], middle, color="C0", lw=0.9, **legend)
    ax.set_xlim(0.0, end_s)
    ax.grid(visible=True, alpha=0.3)


def _finish(axes: Any, end_s: float) -> None:
    """Scales, titles and the settling threshold of e."""
    for ax in axes[0]:
        ax.axhline(SETTLED_ERROR, color="0.4", lw=0.7, ls=":")
        ax.set_yscale("log")
        ax.set_ylim(LEAST_SHOWN_ERROR, 1.5)
    axes[1, 0].set_ylim(bottom=0.0)
    axes[0, 0].set_title("the first second", loc="left")
    axes[0, 1].set_title(f"all {end_s:g} s", loc="left")
    if axes[1, 1].get_legend_handles_labels()[0]:
        legend_above(axes[1, 1], 3)
    for ax in axes[1]:
        ax.set_xlabel("time in s")


def _angles(axes: Any, time_s: Floats, seed: int, result: ExperimentResult) -> None:
    """Roll, pitch and yaw of one seed, true and estimated."""
    true = (result.truth, {"color": "0.2", "lw": 1.4}, "true")
    estimate = (result.estimates, {"color": "C1", "lw": 0.8}, "estimate")
    draw_angles(axes, time_s, (true, estimate))
    for ax in axes:
        ax.set_xlim(0.0, time_s[-1])
        ax.grid(visible=True, alpha=0.3)
    axes[0].set_title(f"angles, noise seed {seed}", loc="left")
    legend_above(axes[0], 2)
    axes[2].set_xlabel("time in s")
