"""Rows that are more than is kept in memory, where no file takes them; others: test_exports."""

import tempfile
from contextlib import nullcontext

import numpy as np
import pytest

from drivers.logs import table
from drivers.logs.table import Table
from tests.programs import largest_file

N = 997
KINDS = {"time_us": "i8", "vector": "3f8", "is_aided": "?"}
LATE_US = 2**62  # more than a float holds to the microsecond
RNG = np.random.default_rng(1)
ROWS = [(LATE_US + k, tuple(RNG.normal(size=3).tolist()), k % 7 == 0) for k in range(N)]


@pytest.mark.parametrize("harm", ["none", "no folder", "full disk"])
def test_rows_come_out_as_they_were_put_in_at_any_time(harm, tmp_path, monkeypatch):
    """A part has 480 bytes or more."""
    monkeypatch.setattr(table, "WAITING", 17)
    monkeypatch.setattr(table, "IN_MEMORY", 60)
    if harm == "no folder":
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    with largest_file(3000) if harm == "full disk" else nullcontext():
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
