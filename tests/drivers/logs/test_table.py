"""Rows that are more than is kept in memory, where no file takes them; others: test_exports."""

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


def no_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))


def full_disk(_tmp_path, _monkeypatch):
    """A process may write files of 3000 bytes; a part has 480 or more."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


@pytest.mark.parametrize("harm", [lambda *_: None, no_folder, full_disk])
def test_rows_come_out_as_they_were_put_in_at_any_time(harm, tmp_path, monkeypatch):
    monkeypatch.setattr(table, "WAITING", 17)
    monkeypatch.setattr(table, "IN_MEMORY", 60)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        harm(tmp_path, monkeypatch)
        made = Table(**KINDS)
        assert made["vector"].shape == (0, 3)
        for k, row in enumerate(ROWS, 1):
            made.append(*row)
            if k % 150 and k < N:
                continue
            assert len(made) == k
            for name, wanted in zip(KINDS, zip(*ROWS[:k], strict=True), strict=True):
                assert made[name].tolist() == np.array(wanted).tolist()
                assert not made[name].flags.writeable
        values = RNG.normal(size=(N, 3))
        for name in ("vector", "another"):
            made.put(name, (values[k : k + 100] for k in range(0, N, 100)))
            assert np.array_equal(made[name], values)
        assert made["time_us"][-1] == LATE_US + N - 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
