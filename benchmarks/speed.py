"""What does a sample cost a program: in batches, call by call, in a loop at 1 kHz?

    python benchmarks/speed.py [DIR] [--loop SECONDS]

``time a sample``: ``fuzzbee.Estimator`` with its defaults, checks and sigmas against ``vqf.VQF``'s
own binding and imufusion: microseconds of processor, the best of rounds in which all take turns,
the one that other programs disturbed least. Compiling, and building a filter, are not timed.
``ratio`` is fuzzbee's time over the other's in the same run: it holds on other machines. Logs have
a benchmark of their own, ``replay_speed.py``.

With ``--loop`` instead one ``Estimator.update`` each millisecond, by the clock, the rest of which
the loop sleeps: median, 99.9th percentile and the worst, in microseconds. The readings are those of
a small IMU at rest, in the 16 bits of its registers; the field comes at 100 Hz. The garbage
collector is off, as ``run`` has it.
"""

import gc
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from functools import partial
from math import inf
from typing import Any

import numpy as np
from common.filters import ImufusionRun, body_readings, is_installed
from common.recordings import Trial, chosen_sets, made_up
from common.report import FOLDERS, MISSING, Row, Tables, benchmark, option

from drivers.simulation.simulated_vehicle import simulate
from fuzzbee import Estimator

ROWS = slice(1000, 7000)  # past the rest that recordings begin with
CALLS = 600  # of them: what takes longer than a few ms, other programs always interrupt
ROUNDS, SMOKE_ROUNDS = 100, 3
PERIOD_S, MAG_EVERY = 1e-3, 10  # of the loop, and samples
LOOP_SHARES = {"median us": 50.0, "99.9 % us": 99.9, "worst us": 100.0}
GYR_LSB_RAD_S, ACC_LSB_M_S2 = np.radians(2000.0 / 32768), 16 * 9.80665 / 32768
MAG_LSB_GAUSS = 0.0015

Start = Callable[[], Callable[[], object]]  # builds a filter and gives what is to be timed
Ways = dict[tuple[str, str], tuple[Start, int]]  # by way and filter; how many samples


def of_samples(trial: Trial) -> Ways:
    """Each way and filter."""
    ours = [column[ROWS] for column in body_readings(trial)]
    theirs = [
        np.ascontiguousarray(c[ROWS]) for c in (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)
    ]
    calls, rows = (list(zip(*(c[:CALLS] for c in some), strict=True)) for some in (ours, theirs))
    short, count = trial.cut(slice(ROWS.start, ROWS.start + CALLS)), len(ours[0])

    def begun() -> Estimator:
        estimator = Estimator("imu", trial.rate_hz)
        estimator.update_batch(*(column[:10] for column in body_readings(trial)))
        return estimator

    return {
        ("batch", "fuzzbee"): (lambda: partial(begun().update_batch, *ours), count),
        ("batch", "vqf"): (lambda: partial(vqf(trial.rate_hz).updateBatch, *theirs), count),
        ("call", "fuzzbee"): (lambda: partial(each, begun().update, calls), CALLS),
        ("call", "vqf"): (lambda: partial(each_asked, vqf(trial.rate_hz), rows), CALLS),
        ("call", "imufusion"): (lambda: partial(ImufusionRun(short).advance, slice(None)), CALLS),
    }


def vqf(rate_hz: float) -> Any:
    from vqf import VQF

    return VQF(1.0 / rate_hz)


def each(update: Callable[..., object], rows: list[tuple[Any, ...]]) -> None:
    for row in rows:
        update(*row)


def each_asked(filter_: Any, rows: list[tuple[Any, ...]]) -> None:
    """VQF's call gives no attitude, which is a call of its own."""
    update, attitude = filter_.update, filter_.getQuat9D
    for row in rows:
        update(*row)
        attitude()


def measure(ways: Ways, rounds: int) -> list[Row]:
    """Microseconds a sample of each that is installed, and those of its way's first over them."""
    there = {key: way for key, way in ways.items() if is_installed(key[1])}
    best = dict.fromkeys(ways, inf)
    for _ in range(rounds):
        for key, (start, count) in there.items():
            run = start()
            begin = time.thread_time()
            run()
            best[key] = min(best[key], 1e6 * (time.thread_time() - begin) / count)
    rows, first_us = list[Row](), dict[str, float]()
    for (way, name), us in best.items():
        figures = {"us a sample": us, "ratio": first_us.setdefault(way, us) / us}
        row = {"way": way, "filter": name}
        rows.append({**row, **(figures if us < inf else {"us a sample": MISSING})})
    return rows


def loop(samples: int, *, has_mag: bool) -> Iterator[float]:
    """Microseconds of each call of ``update``."""
    made, estimator = simulate(0, samples, 1000.0, "rest", noise=0.05, bias=0.0), Estimator()
    lsb = ((made.gyr_rad_s, GYR_LSB_RAD_S), (made.acc_m_s2, ACC_LSB_M_S2))
    gyr, acc, mag = (
        (column / unit).round() * unit for column, unit in (*lsb, (made.mag_gauss, MAG_LSB_GAUSS))
    )
    estimator.update((0.0, 0.0, 0.0), (0.0, 0.0, -9.8), time_s=-1.0)  # compiles, once
    begin_s = time.perf_counter()
    for k in range(samples):
        given = [gyr[k].tolist(), acc[k].tolist()]
        given.append(mag[k].tolist() if has_mag and k % MAG_EVERY == 0 else None)
        called_s = time.perf_counter()
        estimator.update(*given, time_s=PERIOD_S * k)
        yield 1e6 * (time.perf_counter() - called_s)
        time.sleep(max(0.0, begin_s + PERIOD_S * (k + 1) - time.perf_counter()))


@benchmark(*FOLDERS, option("--loop", type=float, default=0.0, metavar="SECONDS"))
def main(options: Namespace) -> Tables:
    rounds = SMOKE_ROUNDS if options.smoke else ROUNDS
    found: dict[str, list[Row]] = {}
    if options.smoke:
        options.loop = 1.0
    if options.smoke or not options.loop:
        trial = next(iter(chosen_sets(options).values()))[0] if options.folders else made_up()
        found[f"time a sample, {trial.name}"] = measure(of_samples(trial), rounds)
    if options.loop:
        gc.disable()
        count = round(options.loop / PERIOD_S)
        found["one call at 1 kHz"] = rows = []
        for name, has_mag in (("6D", False), ("9D", True)):
            took_us = [*loop(count, has_mag=has_mag)]
            figures = {k: round(np.percentile(took_us, q), 1) for k, q in LOOP_SHARES.items()}
            rows.append({"update": name, **figures})
        gc.enable()
    return found
