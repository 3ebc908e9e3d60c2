"""The paper's experiment over several noise seeds: its figures, every sample, the paper's plots."""

import time
from collections.abc import Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, batch_angle_errors
from estimator.profile import Profile
from estimator.types import Floats
from fuzzbee.options import SIMULATION
from fuzzbee.replays.exports import ERRORS, Columns, vectors, write_columns
from fuzzbee.replays.figure import BLACK, DARK, add_legend, written_figure
from fuzzbee.replays.plot import TIME, draw_angles
from fuzzbee.replays.report import ImuSummary, SimulationReport, VehicleSummary
from fuzzbee.replays.score import CONVERGED_RAD, error_summary
from tuning.paper_experiment import SETTLED_ERROR, ExperimentResult, run_experiment

Results = dict[int, ExperimentResult]  # by the noise seed

FIGURE_INCHES = (7.1, 7.6)  # the width of a page's text
TRANSIENT_S = 1.0
# What is drawn of the seeds: the middle one, the middle half, nine in ten.
MEDIAN, BANDS = 50.0, ((5.0, 95.0, 0.18), (25.0, 75.0, 0.35))
LEAST_SHOWN_ERROR = 1e-5


def report_simulation(
    profile: Profile, seeds: Sequence[int], fixed_gain: float | None
) -> tuple[SimulationReport, Results]:
    """Run all seeds. Errors in degrees are over all their samples."""
    started = time.perf_counter()
    results = {seed: run_experiment(profile, seed, fixed_gain) for seed in seeds}
    costs, steady_errors, settling_s, mean_gains, *_ = zip(*results.values(), strict=True)
    errors = [batch_angle_errors(r.estimates, r.truth) for r in results.values()]
    all_errors = np.concatenate(errors)
    everywhere = np.ones(len(all_errors), np.bool_)
    below = [np.flatnonzero(each[:, 0] < CONVERGED_RAD) for each in errors]
    converged_s = [i[0] / COST_RATE_HZ if len(i) else np.inf for i in below]
    samples, hz = len(all_errors), COST_RATE_HZ
    report = SimulationReport(
        source=SIMULATION,
        vehicle=VehicleSummary(1, 1, None, None),
        imu=ImuSummary("RAW_IMU", samples, {"RAW_IMU": samples}, hz, hz, 1.0 / hz, None),
        duration_s=(COST_SAMPLES - 1) / hz,
        reference="sim",
        error_deg=error_summary(all_errors, everywhere, everywhere),
        convergence_s=_median(converged_s),
        mean_gain=float(np.mean(mean_gains)),
        wall_s=time.perf_counter() - started,
        seeds=(seeds[0], seeds[-1]),
        cost=float(np.mean(costs)),
        cost_per_seed=[*costs],
        steady_state_error=float(np.mean(steady_errors)),
        settling_s=_median(settling_s),
    )
    return report, results


def _median(times_s: Sequence[float]) -> float | None:
    """None if it is infinite."""
    median_s = float(np.median(times_s))
    return median_s if isfinite(median_s) else None


def write_csv(path: Path, results: Results) -> None:
    """A row for every sample of every seed.

    ``error`` is the true e, sin^2 of half the error's angle, and the quaternion is the estimate
    before the sample's correction; ``gain`` is the correction's.
    """
    write_columns(path, (_columns(*each) for each in results.items()))


def _columns(seed: int, result: ExperimentResult) -> Columns:
    angles = np.degrees(batch_angle_errors(result.estimates, result.truth))
    time_s = np.arange(len(angles)) / COST_RATE_HZ
    return {
        "seed": np.full(len(angles), seed),
        "time_s": time_s,
        "error": result.true_error,
        "gain": result.gains,
        **vectors("q_{}", "wxyz", result.estimates),
        **vectors("reference_q_{}", "wxyz", result.truth),
        **vectors("error_{}_deg", ERRORS, angles),
    }


def draw(title: str, path: Path, results: Results) -> None:
    """The paper's figures: e and K over time, median and bands of the seeds; one seed's angles."""
    seed, first = next(iter(results.items()))
    time_s = np.arange(len(first.true_error)) / COST_RATE_HZ
    end_s = float(time_s[-1])
    errors = np.array([result.true_error for result in results.values()])
    gains = np.array([result.gains for result in results.values()])
    with written_figure(path, title, FIGURE_INCHES) as sheet:
        ratios = {"height_ratios": [1.0, 1.0, 0.6, 0.6, 0.6], "width_ratios": [1.0, 1.6]}
        grid = sheet.add_gridspec(5, 2, **ratios)
        for column, span_s in enumerate((TRANSIENT_S, end_s)):
            above, below = (sheet.add_subplot(grid[row, column]) for row in (0, 1))
            _draw_seeds(above, time_s, errors, span_s)
            above.set_yscale("log")
            above.set(ylim=(LEAST_SHOWN_ERROR, 1.5), ylabel="" if column else "$e(\\tilde R)$")
            above.plot((0.0, span_s), np.full(2, SETTLED_ERROR), ":", color=DARK, lw=0.7)
            above.set_title(f"all {end_s:g} s" if column else "the first second")
            _draw_seeds(below, time_s, gains, span_s)
            below.set(ylim=(0.0, 1.05 * float(gains.max())), ylabel="" if column else "gain $K$")
            below.set_xlabel(TIME)
        if len(results) > 1:
            add_legend(below, 3)
        axes = [sheet.add_subplot(grid[row, :]) for row in (2, 3, 4)]
        draw_angles(axes, time_s, first.truth, color=BLACK, label="true", lw=1.4)
        draw_angles(axes, time_s, first.estimates, color="tab:orange", label="estimate")
        axes[0].set_title(f"angles, noise seed {seed}")
        axes[2].set_xlabel(TIME)
        for ax in axes:
            ax.set_xlim(0.0, end_s)
        add_legend(axes[0], 2)


def _draw_seeds(ax: Any, time_s: Floats, values: Floats, end_s: float) -> None:
    """Median and bands of (seeds, N) up to ``end_s``."""
    shown = time_s <= end_s
    time_s, values = time_s[shown], values[:, shown]
    for low, high, alpha in BANDS if len(values) > 1 else ():
        between = np.percentile(values, (low, high), axis=0)
        label = f"{low:g} to {high:g} %"
        ax.fill_between(time_s, *between, color="tab:blue", alpha=alpha, lw=0, label=label)
    middle = np.percentile(values, MEDIAN, axis=0)
    ax.plot(time_s, middle, color="tab:blue", lw=0.9, label="median of the seeds")
    ax.set_xlim(0.0, end_s)
