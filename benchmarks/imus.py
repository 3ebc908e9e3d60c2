"""One profile on several sets of recordings, as recorded and made worse, beside VQF.

python benchmarks/imus.py DIR [DIR ...] [--seed 0] [--only "as recorded" "20 % of iron"]

Each DIR as for ``broad.py``. A row a set and a way in which it is made worse: total, inclination
and total with a constant heading taken off, RMS in motion in degrees, mean over the trials,
fuzzbee / VQF; then the share of errors of inclination and heading under the published sigma, in
motion and at rest (behind 5 s). 0.68 is honest.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from broad_data import Array, Trial, load_trials
from broad_live import Said, run_live
from broad_scores import Score, constant_turn, errors_deg, multiply, score
from broad_vqf import run_vqf
from imu_worse import WORSE

SETTLED_S = 5.0
LEAST_ROWS = 50


class Figures(NamedTuple):
    """Of one trial; degrees, and shares under sigma: inclination, heading."""

    ours: Score
    theirs: Score
    free: tuple[float, float]  # total without the constant heading: ours, theirs
    moving: tuple[float, float]
    resting: tuple[float, float]  # nan if it does not rest


def coverage(trial: Trial, said: Said, rows: Array) -> tuple[float, float]:
    """Shares of the errors of inclination and heading under sigma."""
    if rows.sum() < LEAST_ROWS:
        return np.nan, np.nan
    _, heading, inclination = errors_deg(said.q_enu_sensor[rows], trial.q_enu_sensor[rows])
    return (
        float(np.mean(inclination <= said.sigma_inclination_deg[rows])),
        float(np.mean(heading <= said.sigma_heading_deg[rows])),
    )


def judge(trial: Trial) -> Figures:
    """Both filters on the trial."""
    said = run_live(trial)
    theirs = run_vqf(trial)
    times = np.arange(len(trial.moving)) * trial.dt_s
    known = ~np.isnan(trial.q_enu_sensor).any(axis=1) & (times > SETTLED_S)
    free = [
        score(trial, multiply(constant_turn(trial, q), q)).total
        for q in (said.q_enu_sensor, theirs)
    ]
    return Figures(
        score(trial, said.q_enu_sensor),
        score(trial, theirs),
        (free[0], free[1]),
        coverage(trial, said, known & trial.moving),
        coverage(trial, said, known & ~trial.moving),
    )


def row(name: str, way: str, figures: Sequence[Figures]) -> str:
    """Means over the trials, as a line of a table."""
    ours = np.mean([f.ours for f in figures], axis=0)
    theirs = np.mean([f.theirs for f in figures], axis=0)
    free = np.mean([f.free for f in figures], axis=0)
    moving = np.nanmean([f.moving for f in figures], axis=0)
    resting = [f.resting for f in figures if not np.isnan(f.resting).any()]
    rest = "{:.2f}, {:.2f}".format(*np.mean(resting, axis=0)) if resting else "-"
    return (
        f"{name:8} {way:36} total {ours[0]:.2f} / {theirs[0]:.2f} ({ours[0] / theirs[0]:.2f})  "
        f"inclination {ours[2]:.3f} / {theirs[2]:.3f}  free {free[0]:.2f} / {free[1]:.2f}  "
        f"coverage {moving[0]:.2f}, {moving[1]:.2f}  at rest {rest}"
    )


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description="One profile on sets of recordings, as recorded and made worse.",
        epilog="example: python benchmarks/imus.py broad/data repoimu",
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", choices=list(WORSE), default=list(WORSE))
    args = parser.parse_args(argv)
    for folder in args.folders:
        trials = load_trials(folder)
        if not trials:
            print(f"{folder}: no *.mat files", file=sys.stderr)
            return 2
        for way in args.only:
            seeds = [np.random.default_rng([args.seed, k, len(way)]) for k in range(len(trials))]
            worse = [WORSE[way](t, rng) for t, rng in zip(trials, seeds, strict=True)]
            print(row(folder.name, way, [judge(t) for t in worse]), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
