"""How accurate is a recorded flight at a ground station's rates?

    python benchmarks/thinned.py LOG    with the simulator's truth (SIM_STATE)

IMU and velocities are kept at a rate whose intervals scatter by 15 %, ATTITUDE's body rates at one
of their own or with the IMU, where they show nothing more. Columns are those of flights.py, each
the median of ``--draws``.
"""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
from common.report import Row, Tables, benchmark, option
from common.scores import mean_of
from flying.replayed import SHORT_LOG, Events, fly, read, score

from drivers.events import BodyRates, Event, Imu, Velocity

SKIP_S, JITTER = 40.0, 0.15
# Rates of IMU and velocities, and of ATTITUDE (0: it comes with the IMU), in Hz.
RATES_HZ = ((1.0, 0.0), (2.0, 0.0), (2.0, 4.0), (2.0, 10.0), (4.0, 0.0), (4.0, 10.0))


def schedule(rate_hz: float, rng: np.random.Generator) -> Callable[[int], bool]:
    """A test of a time (us): whether it is the first behind one that was due."""
    due_us: float | None = None

    def lets_through(time_us: int) -> bool:
        nonlocal due_us
        due_us = float(time_us) if due_us is None else due_us
        is_due = time_us >= due_us
        while due_us <= time_us:
            due_us += 1e6 / rate_hz * (1.0 + JITTER * float(rng.uniform(-1.0, 1.0)))
        return is_due

    return lets_through


def thin(events: Events, imu_hz: float, attitude_hz: float, draw: int) -> Events:
    """The events that a slower link would carry."""
    rng = np.random.default_rng(500 + draw)
    imu, rates = schedule(imu_hz, rng), schedule(attitude_hz or imu_hz, rng)
    by_message: dict[str, Callable[[int], bool]] = {}

    def is_kept(event: Event) -> bool:
        match event:
            case Imu():
                return imu(event.sample.time_us)
            case BodyRates():
                return attitude_hz > 0.0 and rates(event.sample.time_us)
            case Velocity():
                one = by_message.setdefault(event.message, schedule(imu_hz, rng))
                return one(event.sample.time_us)
        return True

    return [event for event in events if is_kept(event)]


def row(events: Events, imu_hz: float, attitude_hz: float, draws: int, skip_s: float) -> Row:
    """The median of the draws, number by number."""
    rows = [score(fly(thin(events, imu_hz, attitude_hz, k)), skip_s) for k in range(draws)]
    rates = {"IMU Hz": imu_hz, "ATTITUDE Hz": attitude_hz or "with the IMU"}
    return {**rates, **mean_of(rows, median)}


@benchmark(
    option("recording", type=Path, nargs="?", metavar="LOG"),
    option("--draws", type=int, default=3, metavar="N"),
)
def main(options: Namespace) -> Tables:
    rates, skip_s = RATES_HZ, SKIP_S
    if options.smoke:
        options.recording, options.draws = options.recording or SHORT_LOG, 1
        rates, skip_s = rates[-1:], 10.0
    if options.recording is None:
        raise SystemExit("give a LOG, or --smoke")
    events = read(options.recording)
    rows = [row(events, *hz, options.draws, skip_s) for hz in rates]
    return {"at a ground station's rates, degrees": rows}
