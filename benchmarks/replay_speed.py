"""What does a row of a log cost: its replay, the estimate alone, pymavlink's reading, VQF?

    python benchmarks/replay_speed.py [LOG|DIR ...]

``replay`` is all that ``fuzzbee replay`` does, ``rows`` the estimate alone, of samples and reports
in columns, as ``tune`` does for each candidate, ``pymavlink`` its bare reading (of telemetry logs),
``vqf`` its batch without velocity. A row is an IMU sample that is used. ``us a sample`` is of the
processor, the best of rounds in which all take turns. ``ratio`` is replay's time over the other's
in the same process: it holds on other machines. Without a log it is a short one of our own.
"""

from argparse import Namespace
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
from common.report import MISSING, Tables, benchmark, log_files, option
from flying.replayed import SHORT_LOG
from speed import SMOKE_ROUNDS, Start, Ways, measure, vqf

from estimator.profile import load_profile
from fuzzbee import replay
from fuzzbee.tune.read_flight import read_flight
from tuning.flight import fly

ROUNDS = 5


def of_log(log: Path) -> Ways:
    """Each way through a log."""
    profile = load_profile("imu")
    flight = read_flight(log, profile)
    _, *readings, _ = flight.rows
    columns = [np.ascontiguousarray(column * (1.0, -1.0, -1.0)) for column in readings]
    starts: dict[str, Start] = {
        "replay": lambda: partial(replay, log, profile),
        "rows": lambda: partial(fly, flight, profile),
        "pymavlink": lambda: partial(read_by_pymavlink, log),
        "vqf": lambda: partial(vqf(flight.rate_hz).updateBatch, *columns),
    }
    if log.suffix != ".tlog":
        del starts["pymavlink"]
    return {("log", name): (start, len(flight.truth)) for name, start in starts.items()}


def read_by_pymavlink(log: Path) -> None:
    from pymavlink import mavutil

    with closing(mavutil.mavlink_connection(str(log))) as reader:
        while reader.recv_msg() is not None:
            pass


@benchmark(option("logs", type=Path, nargs="*", metavar="LOG", help="logs, or folders of them"))
def main(options: Namespace) -> Tables:
    logs = [SHORT_LOG] if options.smoke else log_files(options.logs) or [SHORT_LOG]
    found = {}
    for log in logs:
        rows = measure(of_log(log), SMOKE_ROUNDS if options.smoke else ROUNDS)
        for row in rows:
            us = row["us a sample"]
            row["rows a second"] = us if us == MISSING else round(1e6 / us)
        found[f"time an IMU sample, {log.name}"] = rows
    return found
