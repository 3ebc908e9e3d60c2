"""What does a sample cost a program, as a batch and call by call, beside other filters?

    python benchmarks/speed.py [DIR]

``fuzzbee.Estimator`` with its defaults, checks and sigmas against ``vqf.VQF``'s own binding and
imufusion: microseconds a sample by the clock, the best of rounds in which all take turns, the one
that other programs disturbed least. Compiling, and building a filter, are not timed. ``ratio`` is
fuzzbee's time over the other's in the same run: it is the figure that holds on other machines.
"""

import sys
import time
from collections.abc import Callable
from math import inf

from common.filters import body_readings, is_installed
from common.recordings import Trial, add_folders, chosen_sets, made_up
from common.report import MISSING, Row, parser, show

from fuzzbee import Estimator

ROWS = slice(1000, 7000)  # past the rest that recordings begin with
CALLS = 600  # of them: what takes longer than a few ms, other programs always interrupt
ROUNDS, SMOKE_ROUNDS = 100, 3
Start = Callable[[], Callable[[], object]]  # builds a filter and gives what is to be timed


def fuzzbee_batch(trial: Trial) -> Start:
    rows = [column[ROWS] for column in body_readings(trial)]

    def start() -> Callable[[], object]:
        estimator = begun(trial)
        return lambda: estimator.update_batch(*rows)

    return start


def fuzzbee_call(trial: Trial) -> Start:
    rows = list(zip(*(column[ROWS][:CALLS] for column in body_readings(trial)), strict=True))

    def start() -> Callable[[], object]:
        update = begun(trial).update
        return lambda: [update(*row) for row in rows]

    return start


def begun(trial: Trial) -> Estimator:
    """An estimator that is aligned."""
    estimator = Estimator("imu", trial.rate_hz)
    estimator.update_batch(*(column[:10] for column in body_readings(trial)))
    return estimator


def vqf_batch(trial: Trial) -> Start:
    from vqf import VQF

    rows = [column[ROWS].copy() for column in (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)]

    def start() -> Callable[[], object]:
        vqf = VQF(trial.dt_s)
        return lambda: vqf.updateBatch(*rows)

    return start


def vqf_call(trial: Trial) -> Start:
    """Its call gives no attitude, which is asked for beside."""
    from vqf import VQF

    columns = (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)
    rows = list(zip(*(column[ROWS][:CALLS].copy() for column in columns), strict=True))

    def start() -> Callable[[], object]:
        vqf = VQF(trial.dt_s)
        update, attitude = vqf.update, vqf.getQuat9D
        return lambda: [(update(*row), attitude()) for row in rows]

    return start


def imufusion_call(trial: Trial) -> Start:
    from common.filters import ImufusionRun

    short = trial.cut(slice(ROWS.start, ROWS.start + CALLS))

    def start() -> Callable[[], object]:
        run = ImufusionRun(short)
        return lambda: run.advance(slice(0, None))

    return start


WAYS = {
    "batch": {"fuzzbee": fuzzbee_batch, "vqf": vqf_batch},
    "call": {"fuzzbee": fuzzbee_call, "vqf": vqf_call, "imufusion": imufusion_call},
}


def measure(trial: Trial, way: str, rounds: int) -> list[Row]:
    """Microseconds a sample of each, and fuzzbee's over it."""
    samples = min(
        len(trial.moving) - ROWS.start, ROWS.stop - ROWS.start if way == "batch" else CALLS
    )
    starts = {name: of(trial) for name, of in WAYS[way].items() if is_installed(name)}
    best = dict.fromkeys(starts, inf)
    for _ in range(rounds):
        for name, start in starts.items():
            run = start()
            begin = time.perf_counter()
            run()
            best[name] = min(best[name], 1e6 * (time.perf_counter() - begin) / samples)
    ours = best["fuzzbee"]
    rows: list[Row] = [
        {"way": way, "filter": name, "us a sample": us, "ratio": ours / us}
        for name, us in best.items()
    ]
    missing = [name for name in WAYS[way] if name not in starts]
    return rows + [{"way": way, "filter": f"{name}: {MISSING}"} for name in missing]


def main() -> int:
    made = parser(__doc__)
    add_folders(made)
    options = made.parse_args()
    trial = next(iter(chosen_sets(options).values()))[0] if options.folders else made_up()
    rounds = SMOKE_ROUNDS if options.smoke else ROUNDS
    rows = [row for way in WAYS for row in measure(trial, way, rounds)]
    show({f"time a sample, {trial.name}": rows}, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
