"""The bar of a log that is read in pieces."""

import os
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.logs import csv_text, log_file
from drivers.logs.open import open_log
from fuzzbee.replays.table import reading_bar

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def a_table(tmp_path):
    """A CSV of 400 kB."""
    rows = [f"{0.01 * k:.2f},0.001,0,{1e-6 * (k % 7)},0,0,-1" for k in range(15_000)]
    table = tmp_path / "table.csv"
    table.write_text("\n".join(["time_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_g,ay_g,az_g", *rows]))
    return table


@pytest.mark.parametrize("name", ["px4_hover.ulg", "sub_bluerov.tlog", "table.csv"])
def test_a_terminal_shows_how_far_a_log_has_been_read(name, a_table, monkeypatch):
    for each in (log_file, csv_text):
        monkeypatch.setattr(each, "READ_SIZE", 70_000)
    monkeypatch.setenv("TERM", "xterm")
    ours, its = os.openpty()
    with open(its, "w") as terminal:  # noqa: PTH123 - a descriptor
        monkeypatch.setattr(sys, "stderr", terminal)
        log = open_log(a_table if name == a_table.name else DATA / name)
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
