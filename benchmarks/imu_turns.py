"""Unsensed turns: how long until the attitude is found again, and whether sigma knew.

python benchmarks/imu_turns.py DIR [DIR ...] [--times 15,40,70] [--angles 20,30,60,179]

Each DIR as for ``broad.py``; recordings with a disturbance are left out. Every attitude inside is
turned about an axis of ENU, either way; the filter is not told. Seconds until the total error is
first under 5 deg, within 25 s, where it stays under 4 deg without the turn (95th percentile).
"aware" is the share of the errors over 5 deg, from 2 s after the turn on, that lie under two
sigmas.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
from broad import KICK_AXES_ENU, turn_about
from broad_data import Trial, load_untroubled
from broad_live import LiveRun, Said
from broad_scores import RECOVERED_DEG, errors_deg

WITHIN_S = 25.0
MOST_ALONE_DEG = 4.0
LATE_S = 2.0
LEAST_LATE = 20  # errors that make a share
# A turn is in motion, or at rest, if this share of the next seconds is.
WHERE_S, WHERE_SHARE = 5.0, 0.8
NEVER_S = float("inf")


class Found(NamedTuple):
    """After one turn."""

    where: str  # "motion", "rest" or "mixed"
    angle_deg: float
    axis: str
    time_s: float  # NEVER_S if not within the time
    aware: float  # nan if few errors last


def where_of(trial: Trial, row: int) -> str:
    """What the vehicle does in the seconds behind the row."""
    share = trial.moving[row : row + round(WHERE_S * trial.rate_hz)].mean()
    if share > WHERE_SHARE:
        return "motion"
    return "rest" if share < 1.0 - WHERE_SHARE else "mixed"


def judge_turn(trial: Trial, row: int, said: Said) -> tuple[float, float]:
    """Time until recovery, and the share of lasting errors that sigma knew of."""
    total = errors_deg(said.q_enu_sensor, trial.q_enu_sensor[row : row + len(said.q_enu_sensor)])[0]
    hits = np.flatnonzero(total < RECOVERED_DEG)
    sigma = np.hypot(said.sigma_inclination_deg, said.sigma_heading_deg)
    late = (total > RECOVERED_DEG) & (np.arange(len(total)) >= LATE_S * trial.rate_hz)
    aware = float(np.mean(total[late] <= 2.0 * sigma[late])) if late.sum() > LEAST_LATE else np.nan
    return (hits[0] + 1) * trial.dt_s if len(hits) else NEVER_S, aware


def judge(trial: Trial, times_s: Sequence[float], angles: Sequence[float]) -> Iterator[Found]:
    """Every turn at every time."""
    for time_s in times_s:
        row = round(time_s * trial.rate_hz) + 1
        end = row + int(WITHIN_S * trial.rate_hz)
        if end > len(trial.moving):
            continue
        run = LiveRun(trial)
        run.advance(1, row)
        before = run.snapshot
        alone = errors_deg(run.advance(row, end).q_enu_sensor, trial.q_enu_sensor[row:end])[0]
        if np.isnan(alone).mean() > 0.1 or np.nanquantile(alone, 0.95) > MOST_ALONE_DEG:
            continue
        where = where_of(trial, row)
        for angle in angles:
            for name, axis in KICK_AXES_ENU.items():
                for sign in (1.0, -1.0):
                    run.snapshot = before
                    run.turn(turn_about(axis, sign * angle))
                    yield Found(where, angle, name, *judge_turn(trial, row, run.advance(row, end)))


def row_of(where: str, angle: float, found: Sequence[Found]) -> str:
    """A line of the table: by axis median (worst), then z and the diagonal together."""
    cells = []
    for name in KICK_AXES_ENU:
        times = [f.time_s for f in found if f.axis == name]
        worst = "never" if max(times) == NEVER_S else f"{max(times):.1f}"
        cells.append(f"{name} {median(times):.1f} ({worst})")
    hard = [f.time_s for f in found if f.axis in ("z", "diagonal")]
    never = sum(f.time_s == NEVER_S for f in found)
    p95 = np.percentile(np.minimum(hard, WITHIN_S), 95)
    aware = np.nanmean([*(f.aware for f in found), np.nan])
    return (
        f"{where:7} {angle:4.0f} deg  {'  '.join(cells)}  z, diagonal: median {median(hard):.1f}, "
        f"p95 {p95:.1f}  never {never} of {len(found)}  aware {aware:.2f}"
    )


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description="Recovery from turns that no sensor has felt.",
        epilog="example: python benchmarks/imu_turns.py broad/data repoimu",
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--times", default="15,40,70", help="seconds, by commas")
    parser.add_argument("--angles", default="20,30,60,179", help="degrees, by commas")
    args = parser.parse_args(argv)
    try:
        times = [float(x) for x in args.times.split(",")]
        angles = [float(x) for x in args.angles.split(",")]
    except ValueError:
        parser.error("--times and --angles are numbers with commas between them")
    trials = load_untroubled(args.folders)
    if not trials:
        print("no undisturbed *.mat files", file=sys.stderr)
        return 2
    found = [f for t in trials for f in judge(t, times, angles)]
    for where in ("rest", "mixed", "motion"):
        for angle in angles:
            some = [f for f in found if f.where == where and f.angle_deg == angle]
            if some:
                print(row_of(where, angle, some))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
