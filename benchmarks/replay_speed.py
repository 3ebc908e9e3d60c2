"""How long does a log take, from its bytes to attitudes, beside others that read or estimate?

    python benchmarks/replay_speed.py LOG...

Microseconds of processor for each IMU sample that is used, the best of rounds in one process.
``replay``: all that ``fuzzbee replay`` does. ``rows``: the estimate alone, of the log's samples and
reports in columns, as ``tune`` does for each candidate. ``pymavlink``: its bare reading of a
telemetry log. ``vqf``: its batch over the same samples, without velocity. ``ratio`` is the time of
``replay`` over the other's.
"""

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from common.filters import is_installed
from common.report import MISSING, Row, parser, show

from estimator.profile import load_profile
from fuzzbee import replay
from fuzzbee.tune.read_flight import read_flight
from tuning.flight import Flight, fly

ROUNDS, SMOKE_ROUNDS = 5, 1
SHORT_LOG = Path(__file__).parents[1] / "tests" / "data" / "sitl_copter_flips.tlog"


def ways(log: Path, flight: Flight) -> Iterator[tuple[str, Callable[[], object] | None]]:
    """Each way through a log; None where what it needs is not installed."""
    profile = load_profile("imu")
    yield "replay", lambda: replay(log, profile)
    yield "rows", lambda: fly(flight, profile, len(flight.truth))
    if log.suffix == ".tlog":
        yield "pymavlink", lambda: read_by_pymavlink(log)
    if not is_installed("vqf"):
        yield "vqf", None
        return
    from vqf import VQF

    _, gyr, acc, mag, _ = flight.rows
    readings = (np.ascontiguousarray(column * (1.0, -1.0, -1.0)) for column in (gyr, acc, mag))
    columns = tuple(readings)
    yield "vqf", lambda: VQF(1.0 / flight.rate_hz).updateBatch(*columns)


def read_by_pymavlink(log: Path) -> None:
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(log))
    while reader.recv_msg() is not None:
        pass


def measure(log: Path, rounds: int) -> list[Row]:
    """Microseconds a sample of each way, and replay's over it."""
    flight = read_flight(log, load_profile("imu"))
    rows: list[Row] = []
    for way, run in ways(log, flight):
        if run is None:
            rows.append({"way": way, "us a sample": MISSING})
            continue
        times_s = []
        for _ in range(rounds):
            begin = time.process_time()
            run()
            times_s.append(time.process_time() - begin)
        us = 1e6 * min(times_s) / len(flight.truth)
        first = rows[0]["us a sample"] if rows else us
        rows.append({"way": way, "us a sample": us, "ratio": first / us})
    return rows


def main() -> int:
    made = parser(__doc__)
    made.add_argument("logs", type=Path, nargs="*", metavar="LOG")
    options = made.parse_args()
    if options.smoke and not options.logs:
        options.logs = [SHORT_LOG]
    if not options.logs:
        made.error("give a LOG, or --smoke")
    rounds = SMOKE_ROUNDS if options.smoke else ROUNDS
    tables = {f"time an IMU sample, {log.name}": measure(log, rounds) for log in options.logs}
    show(tables, as_json=options.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
