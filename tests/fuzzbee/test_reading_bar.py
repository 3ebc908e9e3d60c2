"""The bar of a log that is read in pieces."""

import os
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.logs import csv_text, log_file
from drivers.logs.open import open_log
from fuzzbee.replays.table import reading_bar
from tests.fuzzbee.tlogs import table

DATA = Path(__file__).parents[1] / "data"


@pytest.mark.parametrize("name", ["px4_hover.ulg", "sub_bluerov.tlog", "table.csv"])
def test_a_terminal_shows_how_far_a_log_has_been_read(name, tmp_path, monkeypatch):
    rows = ((0.001, 0, 1e-6 * (k % 7), 0, 0, -1) for k in range(15_000))  # 400 kB
    path = table(tmp_path / name, 100.0, rows) if name == "table.csv" else DATA / name
    for each in (log_file, csv_text):
        monkeypatch.setattr(each, "READ_SIZE", 70_000)
    monkeypatch.setenv("TERM", "xterm")
    ours, its = os.openpty()
    with open(its, "w") as terminal:  # noqa: PTH123 - a descriptor
        monkeypatch.setattr(sys, "stderr", terminal)
        log = open_log(path)
        with reading_bar(log):
            positions = []
            show = log.on_read
            log.on_read = lambda done: (positions.append(done), show(done))
            assert sum(1 for _ in log) > 1000
    seen = b""
    with suppress(OSError):  # whose end it is
        while more := os.read(ours, 100_000):
            seen += more
    os.close(ours)
    assert name in seen.decode()
    assert max(positions) > 0.5 * log.path.stat().st_size


def test_elsewhere_nothing_is_shown(capsys):
    log = open_log(DATA / "px4_hover.ulg")
    with reading_bar(log):
        assert log.on_read is None
    assert capsys.readouterr() == ("", "")
