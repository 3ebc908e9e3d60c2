"""Accuracy, recovery and speed on BROAD, against other filters on the same data.

python benchmarks/broad.py DIR --json [--kick] [--kick-deg 179] [--kick-time 15] [--crop]
    [--rates 285,100,50,25,10] [--filters fuzzbee,vqf] [--plot FILE]
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from broad_data import Array, Trial, crop, decimate, is_undisturbed, load_trials
from broad_filter import Filter
from broad_scores import Score, first_recovery, score

KICK_AXES_ENU = {
    "z": (0.0, 0.0, 1.0),
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "diagonal": (1.0, 1.0, 1.0),
}
KICK_CHUNK_S = 2.0  # the error is checked this often, so that slow filters can stop early
TIMED_CALLS = 2000
TIMED_REPEATS = 5
TIMED_BATCH_S = 0.5  # one repeat of a slow filter computes for so long at most


def _fuzzbee() -> Filter:
    from broad_fuzzbee import FuzzbeeFilter

    return FuzzbeeFilter()


def _vqf() -> Filter:
    from broad_vqf import VqfFilter

    return VqfFilter("vqf", 9.0)


def _vqf_longer_tau() -> Filter:
    from broad_vqf import VqfFilter

    return VqfFilter("vqf_tuned", 20.0)


def _imufusion() -> Filter:
    from broad_imufusion import ImufusionFilter

    return ImufusionFilter()


def _mahony() -> Filter:
    from broad_ahrs import MahonyFilter

    return MahonyFilter()


def _madgwick() -> Filter:
    from broad_ahrs import MadgwickFilter

    return MadgwickFilter()


FILTERS: dict[str, Callable[[], Filter]] = {
    "fuzzbee": _fuzzbee,
    "vqf": _vqf,
    "vqf_tuned": _vqf_longer_tau,
    "imufusion": _imufusion,
    "mahony": _mahony,
    "madgwick": _madgwick,
}


def score_run(filter_: Filter, trial: Trial) -> Score:
    """Errors of a run over the trial."""
    return score(trial, filter_.start(trial).advance(slice(0, None)))


def summary(trials: Sequence[Trial], scores: Sequence[Score]) -> dict[str, Any]:
    """Means over the trials, and the totals by group and by trial."""
    groups: dict[str, list[float]] = {}
    for trial, result in zip(trials, scores, strict=True):
        for group in trial.groups:
            groups.setdefault(group, []).append(result.total)
    return {
        "total_rms_deg": statistics.fmean(s.total for s in scores),
        "heading_rms_deg": statistics.fmean(s.heading for s in scores),
        "inclination_rms_deg": statistics.fmean(s.inclination for s in scores),
        "groups": {name: statistics.fmean(totals) for name, totals in sorted(groups.items())},
        "per_trial": {t.name: s.total for t, s in zip(trials, scores, strict=True)},
    }


def turn_about(axis: Sequence[float], angle_deg: float) -> Array:
    """Quaternion of a turn about an axis of ENU."""
    unit = np.array(axis) / np.linalg.norm(axis)
    half = np.radians(angle_deg) / 2.0
    return np.array([np.cos(half), *(np.sin(half) * unit)])


def recovery_s(filter_: Filter, trial: Trial, turn_enu: Array, time_s: float) -> float | None:
    """Time from the unsensed turn until the total error is first under 5 degrees."""
    run = filter_.start(trial)
    row = round(time_s * trial.rate_hz) + 1
    run.advance(slice(0, row))
    run.turn(turn_enu)
    chunk = round(KICK_CHUNK_S * trial.rate_hz)
    for first in range(row, len(trial.gyr_rad_s), chunk):
        hit = first_recovery(trial, run.advance(slice(first, first + chunk)), first)
        if hit is not None:
            return (first + hit + 1 - row) * trial.dt_s
    return None


def kicks(
    filter_: Filter, trials: Sequence[Trial], angle_deg: float, time_s: float
) -> dict[str, Any]:
    """Recovery on the undisturbed trials, by axis; a failure counts as infinite in the median."""
    result = {}
    for name, axis in KICK_AXES_ENU.items():
        turn = turn_about(axis, angle_deg)
        times = [recovery_s(filter_, t, turn, time_s) for t in trials if is_undisturbed(t)]
        failed = sum(t is None for t in times)
        median = statistics.median([float("inf") if t is None else t for t in times])
        result[name] = {
            "median": median if np.isfinite(median) else None,
            "worst": None if failed else max(t for t in times if t is not None),
            "failed": failed,
            "n": len(times),
        }
    return result


def speed(filters: Sequence[Filter], trial: Trial) -> dict[str, tuple[float, float]]:
    """Nanoseconds a sample, as a batch and call by call; best of rounds, filters taking turns."""
    n = len(trial.gyr_rad_s)
    rows: dict[str, int] = {}
    for f in filters:  # compiles, and shows how many rows one repeat can have
        f.call_each(trial, 10)
        f.start(trial).advance(slice(0, 100))
        begin = time.perf_counter()
        f.start(trial).advance(slice(0, 200))
        per_row = (time.perf_counter() - begin) / 200
        rows[f.name] = min(n, max(200, int(TIMED_BATCH_S / per_row)))
    best: dict[str, tuple[float, float]] = {f.name: (np.inf, np.inf) for f in filters}
    for _ in range(TIMED_REPEATS):
        for f in filters:
            run = f.start(trial)
            begin = time.perf_counter()
            run.advance(slice(0, rows[f.name]))
            batch = (time.perf_counter() - begin) / rows[f.name]
            calls = min(TIMED_CALLS, rows[f.name])
            begin = time.perf_counter()
            f.call_each(trial, calls)
            call = (time.perf_counter() - begin) / calls
            old = best[f.name]
            best[f.name] = (min(old[0], 1e9 * batch), min(old[1], 1e9 * call))
    return best


def measure(trials: Sequence[Trial], names: Sequence[str], args: argparse.Namespace) -> Any:
    """All figures that the options ask for."""
    filters = [FILTERS[name]() for name in names]
    times = speed(filters, trials[0])
    results: dict[str, Any] = {}
    for f in filters:
        print(f"{f.name} ...", file=sys.stderr)
        entry = summary(trials, [score_run(f, t) for t in trials])
        if args.kick:
            entry["kick_s"] = kicks(f, trials, args.kick_deg, args.kick_time)
        if args.rates:
            entry["rates"] = {
                f"{rate:g}": statistics.fmean(score_run(f, decimate(t, rate)).total for t in trials)
                for rate in args.rates
            }
        if args.crop:
            short = [crop(t) for t in trials]
            entry["cropped"] = summary(short, [score_run(f, t) for t in short])
        entry["ns_per_sample_batch"], entry["ns_per_sample_call"] = times[f.name]
        results[f.name] = entry
    return {"trials": len(trials), "filters": results}


def arguments(argv: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Accuracy, recovery and speed on BROAD.",
        epilog="example: python benchmarks/broad.py broad/data --json --kick --crop --rates 100,25",
    )
    parser.add_argument("folder", type=Path, help="BROAD's *.mat files, with trials.json")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--kick", action="store_true", help="recovery from an unsensed turn")
    parser.add_argument("--kick-deg", type=float, default=179.0)
    parser.add_argument("--kick-time", type=float, default=15.0, metavar="S")
    parser.add_argument("--crop", action="store_true", help="also from the first movement on")
    parser.add_argument("--rates", default="", help="block means at these rates, Hz, by commas")
    parser.add_argument("--filters", default=",".join(FILTERS), help="which, by commas")
    parser.add_argument("--plot", type=Path, metavar="FILE")
    args = parser.parse_args(argv)
    try:
        args.rates = [float(rate) for rate in args.rates.split(",") if rate]
    except ValueError:
        parser.error(f"--rates: {args.rates!r} is not a list of numbers")
    if any(rate <= 0.0 for rate in args.rates):
        parser.error("--rates: rates are above 0 Hz")
    args.filters = args.filters.split(",")
    unknown = [name for name in args.filters if name not in FILTERS]
    if unknown:
        parser.error(f"--filters: {unknown[0]!r} is none of {', '.join(FILTERS)}")
    return args


def main(argv: Sequence[str]) -> int:
    args = arguments(argv)
    trials = load_trials(args.folder)
    if not trials:
        print(f"{args.folder}: no *.mat files", file=sys.stderr)
        return 2
    result = measure(trials, args.filters, args)
    if args.plot:
        from broad_plot import plot

        plot(result, args.plot)
    if args.json:
        print(json.dumps(result))
    else:
        for name, entry in result["filters"].items():
            print(f"{name:10s} total {entry['total_rms_deg']:.2f} deg")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
