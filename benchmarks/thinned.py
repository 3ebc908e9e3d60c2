"""How accurate is a recorded flight at a ground station's rates?

    python benchmarks/thinned.py LOG    with the simulator's truth (SIM_STATE)

IMU and velocities are kept at a rate whose intervals scatter by 15 %, ATTITUDE's body rates at one
of their own or with the IMU, where they show nothing more. Columns are those of flights.py, each
the median of ``--draws``.
"""

from argparse import Namespace
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


class Schedule:
    """Lets through the first event behind each due time."""

    def __init__(self, rate_hz: float, rng: np.random.Generator) -> None:
        self._period_us, self._rng = 1e6 / rate_hz, rng
        self._due_us: float | None = None

    def lets_through(self, time_us: int) -> bool:
        """Whether an event of that time is kept."""
        self._due_us = float(time_us) if self._due_us is None else self._due_us
        if time_us < self._due_us:
            return False
        while self._due_us <= time_us:
            scatter = 1.0 + JITTER * float(self._rng.uniform(-1.0, 1.0))
            self._due_us += self._period_us * scatter
        return True


def thin(events: Events, imu_hz: float, attitude_hz: float, draw: int) -> Events:
    """The events that a slower link would carry."""
    rng = np.random.default_rng(500 + draw)
    imu, rates = Schedule(imu_hz, rng), Schedule(attitude_hz or imu_hz, rng)
    by_message: dict[str, Schedule] = {}

    def is_kept(event: Event) -> bool:
        match event:
            case Imu():
                return imu.lets_through(event.sample.time_us)
            case BodyRates():
                return attitude_hz > 0.0 and rates.lets_through(event.sample.time_us)
            case Velocity():
                one = by_message.setdefault(event.message, Schedule(imu_hz, rng))
                return one.lets_through(event.sample.time_us)
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
