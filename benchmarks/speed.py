"""What does a sample cost a program, as a batch and call by call, beside other filters?

    python benchmarks/speed.py [DIR]

``fuzzbee.Estimator`` with its defaults, checks and sigmas against ``vqf.VQF``'s own binding and
imufusion: microseconds of processor a sample, the best of rounds in which all take turns, the one
that other programs disturbed least. Compiling, and building a filter, are not timed. ``ratio`` is
fuzzbee's time over the other's in the same run: it is the figure that holds on other machines.
"""

import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from math import inf
from typing import Any

import numpy as np
from common.filters import ImufusionRun, body_readings, is_installed
from common.recordings import Trial, add_folders, chosen_sets, made_up
from common.report import MISSING, Row, parser, show

from fuzzbee import Estimator

ROWS = slice(1000, 7000)  # past the rest that recordings begin with
CALLS = 600  # of them: what takes longer than a few ms, other programs always interrupt
ROUNDS, SMOKE_ROUNDS = 100, 3
Start = Callable[[], Callable[[], object]]  # builds a filter and gives what is to be timed
Rows = list[tuple[Any, ...]]
WAYS = (
    ("batch", "fuzzbee"),
    ("batch", "vqf"),
    ("call", "fuzzbee"),
    ("call", "vqf"),
    ("call", "imufusion"),
)


def begun(trial: Trial) -> Estimator:
    """An estimator that is aligned."""
    estimator = Estimator("imu", trial.rate_hz)
    estimator.update_batch(*(column[:10] for column in body_readings(trial)))
    return estimator


def starts(trial: Trial) -> Iterator[tuple[str, str, Start]]:
    """Each way and filter that is installed."""
    ours = [column[ROWS] for column in body_readings(trial)]
    calls = list(zip(*(column[:CALLS] for column in ours), strict=True))
    yield "batch", "fuzzbee", lambda: partial(begun(trial).update_batch, *ours)
    yield "call", "fuzzbee", lambda: partial(each, begun(trial).update, calls)
    if is_installed("vqf"):
        from vqf import VQF

        columns = (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)
        theirs = [np.ascontiguousarray(column[ROWS]) for column in columns]
        rows = list(zip(*(column[:CALLS] for column in theirs), strict=True))
        yield "batch", "vqf", lambda: partial(VQF(trial.dt_s).updateBatch, *theirs)
        yield "call", "vqf", lambda: partial(each_asked, VQF(trial.dt_s), rows)
    if is_installed("imufusion"):
        short = trial.cut(slice(ROWS.start, ROWS.start + CALLS))
        yield "call", "imufusion", lambda: partial(ImufusionRun(short).advance, slice(0, None))


def each(update: Callable[..., object], rows: Rows) -> None:
    for row in rows:
        update(*row)


def each_asked(vqf: Any, rows: Rows) -> None:
    """VQF's call gives no attitude, which is asked for beside."""
    update, attitude = vqf.update, vqf.getQuat9D
    for row in rows:
        update(*row)
        attitude()


def measure(trial: Trial, rounds: int) -> list[Row]:
    """Microseconds a sample of each, and fuzzbee's over it; what is not there says so."""
    found = {(way, name): start for way, name, start in starts(trial)}
    batch = min(len(trial.moving), ROWS.stop) - ROWS.start
    best = dict.fromkeys(found, inf)
    for _ in range(rounds):
        for (way, name), start in found.items():
            run = start()
            begin = time.thread_time()
            run()
            us = 1e6 * (time.thread_time() - begin) / (batch if way == "batch" else CALLS)
            best[way, name] = min(best[way, name], us)
    rows: list[Row] = []
    for way, name in WAYS:
        row: Row = {"way": way, "filter": name}
        if (way, name) in best:
            us = best[way, name]
            rows.append({**row, "us a sample": us, "ratio": best[way, "fuzzbee"] / us})
        else:
            rows.append({**row, "us a sample": MISSING})
    return rows


def main() -> int:
    made = parser(__doc__)
    add_folders(made)
    options = made.parse_args()
    trial = next(iter(chosen_sets(options).values()))[0] if options.folders else made_up()
    rounds = SMOKE_ROUNDS if options.smoke else ROUNDS
    show({f"time a sample, {trial.name}": measure(trial, rounds)}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
