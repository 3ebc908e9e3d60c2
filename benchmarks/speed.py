"""What a sample costs a program, as a batch and call by call, beside VQF's own binding (BROAD).

    python benchmarks/speed.py FOLDER [--json]

``batch`` and ``call`` are what both offer programs: ``fuzzbee.Estimator`` with its defaults, checks
and sigmas, and ``vqf.VQF``. ``filter`` is the filter alone, a recording in one compiled loop, as
``broad.py`` times it. Microseconds a sample by the clock; the best of rounds in which both take
turns, the one that other programs disturbed least. Compiling, and building an estimator, are not
timed. ``ratio`` is fuzzbee's over VQF's in the same run.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from broad_data import Trial, cut, load_trials
from broad_filter import Filter
from broad_fuzzbee import FuzzbeeFilter
from broad_vqf import VqfFilter
from vqf import VQF

from fuzzbee import Estimator, load_profile

FRD_OF_SENSOR = np.array([1.0, -1.0, -1.0])
GAUSS_PER_MICRO_TESLA = 0.01
ROWS = slice(1000, 7000)  # past the rest that trials begin with
CALLS = 600  # of them: what takes longer than a few ms, other programs always interrupt
ROUNDS = 100
Run = Callable[[], object]


def fuzzbee_runs(trial: Trial) -> dict[str, Callable[[], Run]]:
    """What starts an estimator and gives what is to be timed."""
    profile = load_profile("imu")
    gyr = trial.gyr_rad_s[ROWS] * FRD_OF_SENSOR
    acc = trial.acc_m_s2[ROWS] * FRD_OF_SENSOR
    mag = trial.mag_ut[ROWS] * FRD_OF_SENSOR * GAUSS_PER_MICRO_TESLA

    def start() -> Estimator:
        estimator = Estimator(profile, trial.rate_hz)
        for k in range(10):  # aligns it
            estimator.update(gyr[0], acc[0], mag[0] * (1.0 + 1e-6 * k))
        return estimator

    def batch() -> Run:
        estimator = start()
        return lambda: estimator.update_batch(gyr, acc, mag)

    def call() -> Run:
        update, rows = start().update, list(zip(gyr, acc, mag, strict=True))[:CALLS]

        def run() -> None:
            for g, a, m in rows:
                update(g, a, m)

        return run

    return {"filter": lambda: filter_run(FuzzbeeFilter(), trial), "batch": batch, "call": call}


def vqf_runs(trial: Trial) -> dict[str, Callable[[], Run]]:
    """The same of VQF; its call gives no attitude, which is asked for beside."""
    gyr, acc, mag = (
        np.ascontiguousarray(v[ROWS]) for v in (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)
    )

    def batch() -> Run:
        vqf = VQF(trial.dt_s)
        return lambda: vqf.updateBatch(gyr, acc, mag)

    def call() -> Run:
        vqf = VQF(trial.dt_s)
        update, attitude = vqf.update, vqf.getQuat9D
        rows = list(zip(gyr, acc, mag, strict=True))[:CALLS]

        def run() -> None:
            for g, a, m in rows:
                update(g, a, m)
                attitude()

        return run

    return {
        "filter": lambda: filter_run(VqfFilter("vqf", 9.0), trial),
        "batch": batch,
        "call": call,
    }


def filter_run(filter_: Filter, trial: Trial) -> Run:
    """What ``broad.py`` times: for fuzzbee the compiled loop alone, for VQF its batch again."""
    short = cut(trial, ROWS)
    run = filter_.start(short)
    return lambda: run.advance(slice(0, len(short.gyr_rad_s)))


def measure(trial: Trial) -> dict[str, dict[str, float]]:
    """Microseconds a sample and their ratio, of each way."""
    filters = {"fuzzbee": fuzzbee_runs(trial), "vqf": vqf_runs(trial)}
    rows = len(trial.gyr_rad_s[ROWS])
    result = {}
    for way, samples in (("filter", rows), ("batch", rows), ("call", CALLS)):
        best = dict.fromkeys(filters, np.inf)
        for _ in range(ROUNDS):
            for name, runs in filters.items():
                run = runs[way]()
                begin = time.perf_counter()
                run()
                best[name] = min(best[name], 1e6 * (time.perf_counter() - begin) / samples)
        result[way] = {**best, "ratio": best["fuzzbee"] / best["vqf"]}
    return result


def main() -> None:
    """The first trial of the folder."""
    parser = argparse.ArgumentParser(description="What a sample costs, beside VQF.")
    parser.add_argument("folder", type=Path, help="BROAD's *.mat files, with trials.json")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    args = parser.parse_args()
    trials = load_trials(args.folder)
    if not trials:
        print(f"{args.folder}: no *.mat files", file=sys.stderr)
        raise SystemExit(2)
    result = measure(trials[0])
    if args.json:
        print(json.dumps(result))
        return
    for way, row in result.items():
        print(f"{way:6} " + "  ".join(f"{name} {value:.2f}" for name, value in row.items()))


if __name__ == "__main__":
    main()
