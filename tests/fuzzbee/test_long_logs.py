"""Logs of more samples than are held in memory: the same figures and files, in bounded memory."""

import pytest

from drivers.logs import table
from tests.fuzzbee.recording import DATA
from tests.programs import run_python

WRITTEN = {"--csv": "flight.csv", "--tum": "flight.tum", "--mcap": "flight.mcap"}


@pytest.fixture
def written(replayed, tmp_path):
    """The figures, and what was written."""

    def run(log, *options):
        files = [part for name, file in WRITTEN.items() for part in (name, tmp_path / file)]
        figures = replayed(DATA / log, *files, *options)
        del figures["wall_s"]
        return figures, {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    return run


def close(some, others):
    """Whether two reports are the same but for the order of their sums."""
    if isinstance(some, dict):
        return some.keys() == others.keys() and all(close(some[k], others[k]) for k in some)
    return some == pytest.approx(others, rel=1e-12) if isinstance(some, float) else some == others


@pytest.mark.parametrize(
    ("log", "options"),
    [
        ("sitl_copter_4hz.tlog", ("--skip", "20")),
        ("sub_bluerov.tlog", ("--start-wrong", "170")),
        ("sub_on_its_side.tlog", ("--smooth",)),
    ],
)
def test_a_replay_in_small_parts_is_the_same(written, monkeypatch, log, options):
    whole = written(log, *options)
    for name, rows in (("BLOCK", 70), ("WAITING", 70), ("IN_MEMORY", 90)):
        monkeypatch.setattr(table, name, rows)
    parts = written(log, *options)
    assert close(whole[0], parts[0])
    assert whole[1] == parts[1]


LONG = """
from pathlib import Path
import numpy as np
from drivers.events import ReferenceAttitude, VehicleId
from estimator.estimator import Estimator
from estimator.profile import load_profile
from estimator.types import IDENTITY, Attitude, ImuSample
from fuzzbee.replays.score import compare, score
from fuzzbee.replays.trace import VehicleTrace
from service.vehicle import Vehicle

def most_kb():
    line = next(each for each in open("/proc/self/status") if each.startswith("VmHWM"))
    return int(line.split()[1])  # of this program alone, unlike ru_maxrss


trace, n = VehicleTrace(VehicleId(1, 1)), 1_440_000
trace.vehicle = Vehicle(trace.address, Estimator(load_profile("imu")))
before_kb = most_kb()  # libraries without bytecode take 60 MB more to import
for k in range(0, n, 10_000):
    rows = np.random.default_rng(k).normal(0.0, 1e-4, (10_000, 25)).tolist()
    for us, row in enumerate(rows, k):
        us, vectors = 2_500 * us, [tuple(row[i : i + 3]) for i in range(0, 15, 3)]
        attitude = Attitude(us, (1.0, *row[15:18]), *vectors[:2], *row[18:], "true")
        trace.take(us, us, attitude, ImuSample(us, *vectors[2:], True), True)
    us = 2_500 * k
    trace.references["sim"].add(ReferenceAttitude(trace.address, us, us, "sim", "SIM", IDENTITY))
compare(Path("x"), trace, None)
report = score(Path("x"), trace, 0.0)
print(report.imu.samples, most_kb() - before_kb)
"""


def test_an_hour_at_400_hz_takes_no_more_memory_than_its_columns_one_by_one():
    done = run_python("-c", LONG, timeout_s=900)
    samples, taken_kb = map(int, done.stdout.split())
    assert samples == 1_440_000
    assert taken_kb < 186_000
