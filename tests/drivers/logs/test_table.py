"""Rows that are more than is kept in memory: what was put in comes out."""

import resource
import tempfile

import numpy as np
import pytest

from drivers.logs import table
from drivers.logs.table import Table

N = 997
KINDS = {"time_us": "i8", "vector": "3f8", "is_aided": "?"}
LATE_US = 2**62  # more than a float holds to the microsecond
RNG = np.random.default_rng(1)
ROWS = [(LATE_US + k, tuple(RNG.normal(size=3).tolist()), k % 7 == 0) for k in range(N)]


@pytest.fixture(params=["in memory", "in files", "no room"])
def small(request, monkeypatch, tmp_path):
    """Files from 60 rows on; or a folder where none can be made."""
    monkeypatch.setattr(table, "WAITING", 17)
    if request.param != "in memory":
        monkeypatch.setattr(table, "IN_MEMORY", 60)
    folder = tmp_path / "none" if request.param == "no room" else tmp_path
    monkeypatch.setattr(tempfile, "tempdir", str(folder))


def filled():
    made = Table(**KINDS)
    for row in ROWS:
        made.append(*row)
    return made


def assert_whole(made, rows):
    assert len(made) == len(rows)
    for name, wanted in zip(KINDS, zip(*rows, strict=True), strict=True):
        assert made[name].tolist() == np.array(wanted).tolist()
        assert not made[name].flags.writeable


@pytest.mark.usefixtures("small")
def test_rows_come_out_as_they_were_put_in_at_any_time():
    made = Table(**KINDS)
    assert made["vector"].shape == (0, 3)
    for k, row in enumerate(ROWS):
        made.append(*row)
        if k % 150 == 149:
            assert_whole(made, ROWS[: k + 1])
    assert_whole(made, ROWS)


@pytest.mark.usefixtures("small")
def test_a_column_is_put_in_parts_beside_the_others_or_in_the_place_of_one():
    made, values = filled(), RNG.normal(size=(N, 3))
    for name in ("vector", "another"):
        made.put(name, (values[k : k + 100] for k in range(0, N, 100)))
        assert np.array_equal(made[name], values)
    assert made["time_us"][-1] == LATE_US + N - 1


def test_a_disk_that_is_full_leaves_the_rest_in_memory(monkeypatch):
    """A process may write files of 3000 bytes; a part has 480 or more."""
    monkeypatch.setattr(table, "IN_MEMORY", 60)
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, usual[1]))
    try:
        made = filled()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert_whole(made, ROWS)
