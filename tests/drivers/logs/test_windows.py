"""Logs larger than what is held of them in memory: the same events, in bounded memory."""

import os
import random
import subprocess
import sys

import pytest

from drivers.events import Imu
from drivers.logs import log_file, ulog
from drivers.logs.open import open_log
from tests.drivers.logs import test_dataflash, test_tlog, test_ulog
from tests.drivers.logs.writers import UlogWriter

READ = """
import resource, sys
from pathlib import Path
from drivers.logs.open import open_log
from estimator.errors import InputError
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    print(sum(1 for _ in open_log(Path(sys.argv[1]))))
except InputError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def grown_kb(path):
    """By how much a process has grown that has read the log."""
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True
    )
    return int(done.stdout.splitlines()[-1])


def damaged(data):
    """With stretches of noise, one of which is longer than a piece."""
    third = len(data) // 3
    return (
        data[:third]
        + bytes(range(256)) * 700
        + data[third : 2 * third]
        + b"\xfd\xfe" * 99
        + data[2 * third :]
    )


def dataflash():
    """Between its messages some 60,000 of three bytes, which nobody wants."""
    log = test_dataflash.modern(seconds=20)
    log.format("NIL", "", "", 7)
    return log.data + b"\xa3\x95\x07" * 60_000 + log.data


LOGS = {
    "long.tlog": lambda: b"".join(test_tlog.steady(6000)),
    "long.bin": dataflash,
    "long.ulg": test_ulog.HOVER.read_bytes,
}


@pytest.mark.parametrize("harm", [bytes, damaged])
@pytest.mark.parametrize("name", LOGS)
def test_a_log_in_pieces_has_the_same_events(tmp_path, name, harm, monkeypatch):
    path = tmp_path / name
    path.write_bytes(harm(LOGS[name]()))
    monkeypatch.setattr(log_file, "READ_SIZE", 70_000)
    pieces = list(open_log(path))
    monkeypatch.setattr(log_file, "READ_SIZE", 1 << 26)
    assert pieces == list(open_log(path))
    assert len(pieces) > 3000


def test_a_sparse_telemetry_log_takes_no_memory(tmp_path):
    path = tmp_path / "sparse.tlog"
    path.write_bytes(b"".join(test_tlog.steady(20)))
    with path.open("r+b") as file:
        file.truncate(1 << 29)
    assert grown_kb(path) < 100_000  # half a gigabyte long


def test_rows_that_come_late_are_put_in_order(tmp_path, monkeypatch):
    """Of a log that is longer than what is held of it; a logger writes what waits."""
    monkeypatch.setattr(ulog, "MOST_HELD", 50)
    rng = random.Random(3)
    times_us = [1_000_000 + 5000 * k for k in range(400)]
    late = sorted(times_us, key=lambda us: us + rng.randrange(200_000))
    log = UlogWriter().sensors()
    for now_us in late:
        log.sample(now_us, test_ulog.noisy(rng, (0, 0, 0)), test_ulog.noisy(rng, (0, 0, -9.8)))
    events = list(open_log(log.save(tmp_path)))
    assert [each.sample.time_us for each in events if isinstance(each, Imu)] == times_us


def test_a_ulog_takes_no_memory_for_its_length(tmp_path):
    """Between two halves of a flight 130 MB of a logger's words."""
    words = b"\xff\xffL"
    data = test_ulog.HOVER.read_bytes()
    path = tmp_path / "sparse.ulg"
    with path.open("wb") as file:
        file.write(data)
        for _ in range(2000):
            file.write(words)
            file.seek(0xFFFF, os.SEEK_CUR)
        file.truncate(file.tell())
    assert grown_kb(path) < 100_000
