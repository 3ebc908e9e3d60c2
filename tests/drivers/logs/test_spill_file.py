"""Rows that are more than is kept in memory: what was put in comes out."""

import resource
import tempfile

import numpy as np
import pytest

from drivers.logs import percentile, spill_file
from drivers.logs.spill_file import SpillFile

N = 997


@pytest.fixture(params=["in files", "no room"])
def small(request, monkeypatch, tmp_path):
    """A piece of 60 numbers, blocks of 40 rows; or a folder where no file can be made."""
    monkeypatch.setattr(spill_file, "PIECE", 60)
    monkeypatch.setattr(spill_file, "BLOCK", 40)
    monkeypatch.setattr(percentile, "BLOCK", 40)
    folder = tmp_path if request.param == "in files" else tmp_path / "none"
    monkeypatch.setattr(tempfile, "tempdir", str(folder))


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(("code", "width"), [("d", 7), ("q", 1), ("b", 1)])
def test_rows_come_out_as_they_were_put_in(code, width):
    rng = np.random.default_rng(1)
    rows = rng.integers(-99, 99, (N, width)).astype(code)
    kept = SpillFile(code, width)
    for row in rows[:500]:
        kept.extend(row.tolist())
    kept.add(rows[500:])
    rows = rows if width > 1 else rows[:, 0]
    for part in (slice(None), slice(3), slice(55, 58), slice(-5, None), slice(9, 9), slice(400, N)):
        assert np.array_equal(kept.rows(part), rows[part])
    assert np.array_equal(np.concatenate(list(kept.parts())), rows)
    kept.write(480, rows[:400])
    rows[480:880] = rows[:400].copy()
    kept.write(990, rows[:7])
    rows[990:] = rows[:7]
    assert np.array_equal(kept.rows(), rows)
    assert kept.rows().flags.writeable


@pytest.mark.usefixtures("small")
def test_an_ascending_column_is_looked_up_and_has_steps():
    times = np.sort(np.random.default_rng(2).integers(0, 3000, N))
    kept = SpillFile("q")
    kept.add(times)
    for value in (-1, 0, 7, 1500.5, 3000, 4000):
        assert kept.first_from(value) == np.searchsorted(times, value)
    assert np.array_equal(np.concatenate(list(kept.steps())), np.diff(times))
    assert kept.latest == times[-1]


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("percent", [0.0, 12.3, 50.0, 95.0, 100.0])
@pytest.mark.parametrize("n", [0, 1, 39, N])
def test_percentiles_in_parts_are_those_of_the_whole(percent, n):
    values = np.round(np.random.default_rng(3).exponential(1e-3, n), 5)
    kept = SpillFile("d")
    kept.add(values)
    found = percentile.percentile(kept.parts, percent)
    assert np.isnan(found) if n == 0 else found == pytest.approx(np.percentile(values, percent))


def test_a_disk_that_is_full_leaves_the_rest_in_memory(monkeypatch):
    """A process may write files of 3000 bytes; a piece is 480 or a row more."""
    monkeypatch.setattr(spill_file, "PIECE", 60)
    kept, usual = SpillFile("d", 7), resource.getrlimit(resource.RLIMIT_FSIZE)
    rows = np.random.default_rng(4).standard_normal((N, 7))
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, usual[1]))
    try:
        for row in rows.tolist():
            kept.extend(row)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert np.array_equal(kept.rows(), rows)
