"""A fast recording with the simulator's truth, thinned to a ground station's rates.

IMU and velocities are kept at a rate whose intervals scatter by 15 %, ATTITUDE's body rates at
one of their own or with the IMU, where they show nothing more. Each row is the median of the draws.

example: python benchmarks/thinned.py sitl_copter_fast.tlog --draws 3
"""

import argparse
import statistics
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from flight_changes import Events
from flight_score import Score, line, score

from drivers.events import BodyRates, Event, Imu, Velocity
from drivers.logs.open import open_log

SKIP_S = 40.0
JITTER = 0.15
# Rates of IMU and velocities, and of ATTITUDE (0: it comes with the IMU), in Hz.
ROWS = ((1.0, 0.0), (2.0, 0.0), (2.0, 4.0), (2.0, 10.0), (4.0, 0.0), (4.0, 10.0))


class Schedule:
    """Lets through the first event behind each due time."""

    def __init__(self, rate_hz: float, rng: np.random.Generator) -> None:
        self._period_us, self._rng = 1e6 / rate_hz, rng
        self._due_us: float | None = None

    def lets_through(self, time_us: int) -> bool:
        """Whether an event of that time is kept."""
        if self._due_us is None:
            self._due_us = float(time_us)
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
    velocities: dict[str, Schedule] = {}

    def is_kept(event: Event) -> bool:
        match event:
            case Imu():
                return imu.lets_through(event.sample.time_us)
            case BodyRates():
                return attitude_hz > 0.0 and rates.lets_through(event.sample.time_us)
            case Velocity():
                one = velocities.setdefault(event.message, Schedule(imu_hz, rng))
                return one.lets_through(event.sample.time_us)
        return True

    return [event for event in events if is_kept(event)]


def median(scores: list[Score]) -> Score:
    """Number by number."""
    return Score(*(statistics.median(column) for column in zip(*scores, strict=True)))


def main() -> None:
    """A row for each pair of rates."""
    parser = argparse.ArgumentParser(description="A recording at a ground station's rates.")
    parser.add_argument("recording", type=Path, metavar="LOG")
    parser.add_argument("--draws", type=int, default=3, metavar="N")
    options = parser.parse_args()
    with open_log(options.recording) as log:
        events = list(log)
    for imu_hz, attitude_hz in ROWS:
        scores = [
            score(thin(events, imu_hz, attitude_hz, draw), skip_s=SKIP_S)
            for draw in range(options.draws)
        ]
        attitude = f"ATTITUDE {attitude_hz:g} Hz" if attitude_hz else "ATTITUDE with it"
        print(line(f"IMU {imu_hz:g} Hz, {attitude}", median(scores)), flush=True)


if __name__ == "__main__":
    main()
