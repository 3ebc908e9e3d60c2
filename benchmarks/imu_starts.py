"""Starts in motion: RMS of the total error from 10 to 30 s after, beside VQF.

python benchmarks/imu_starts.py DIR [DIR ...] [--starts 10] [--shift 0.5]

Each DIR as for ``broad.py``; recordings with a disturbance are left out. A recording begins anew
at so many times, evenly spread over its motion; ``--shift`` moves them by that share of the
spacing. A constant heading by which the whole recording is off, with its iron or its truth, is
taken off where the set's truth has no north of its own (``--free``).
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from broad_data import Array, Trial, cut, load_untroubled
from broad_live import run_live
from broad_scores import constant_turn, errors_deg, multiply
from broad_vqf import run_vqf

BEGIN_S, END_S = 10.0, 30.0
LEAST_S = 15.0  # of a recording behind a start
LEAST_SCORED_S = 3.0
BAD_DEG = 3.0
NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
Run = Callable[[Trial], Array]


def fuzzbee(trial: Trial) -> Array:
    return run_live(trial).q_enu_sensor


def beginnings(trial: Trial, starts: int, shift: float) -> Iterator[Trial]:
    """The recording from each start on, for half a minute."""
    moving = np.flatnonzero(trial.moving)
    span = round(END_S * trial.rate_hz)
    first, last = moving[0], max(moving[0] + 1, moving[-1] - span)
    spacing = (last - first) / max(1, starts - 1)
    for k in range(starts):
        at = min(last, first + round((k + shift) * spacing))
        begin = int(moving[np.searchsorted(moving, at)])
        yield cut(trial, slice(begin, min(begin + span, len(trial.moving))))


def judge(trial: Trial, run: Run, args: argparse.Namespace) -> Iterator[float]:
    """The error after each start."""
    turn = NO_TURN
    if args.free:
        turn = constant_turn(trial, run(trial))
    for short in beginnings(trial, args.starts, args.shift):
        rows = short.scored & (np.arange(len(short.scored)) * trial.dt_s >= BEGIN_S)
        enough = len(rows) >= LEAST_S * trial.rate_hz
        if enough and rows.sum() >= LEAST_SCORED_S * trial.rate_hz:
            total = errors_deg(multiply(turn, run(short))[rows], short.q_enu_sensor[rows])[0]
            yield float(np.sqrt(np.mean(total**2)))


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description="Starts in motion on sets of recordings.",
        epilog="example: python benchmarks/imu_starts.py broad/data",
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="DIR")
    parser.add_argument("--starts", type=int, default=10, help="a recording")
    parser.add_argument("--shift", type=float, default=0.0, help="of the spacing")
    parser.add_argument("--free", action="store_true", help="take a constant heading off")
    args = parser.parse_args(argv)
    for folder in args.folders:
        trials = load_untroubled([folder])
        if not trials:
            print(f"{folder}: no undisturbed *.mat files", file=sys.stderr)
            return 2
        for name, run in (("fuzzbee", fuzzbee), ("vqf", run_vqf)):
            errors = [e for t in trials for e in judge(t, run, args)]
            over = sum(e > BAD_DEG for e in errors)
            mean, worst = np.mean(errors), max(errors)
            print(
                f"{folder.name:8} {name:8} {len(errors)} starts: mean {mean:.2f} deg, "
                f"worst {worst:.1f}, {over} over {BAD_DEG:g}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
