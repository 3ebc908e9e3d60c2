"""Checkpoints come back as they were, and damaged or foreign ones are refused in one line."""

import numpy as np
import pytest

from estimator.errors import InputError
from tuning.checkpoint import (
    checkpoint_path,
    read_checkpoint,
    write_atomically,
    write_checkpoint,
)
from tuning.search import Record

IDENTITY = {"options": {"sources": 3, "algorithm": "abc"}, "inputs": [{"name": "sim:"}]}
RECORD = Record(np.array([1.5, 1 / 3, 7e300]), "ab" * 32)


def test_round_trip(tmp_path):
    path = tmp_path / "x.checkpoint"
    write_checkpoint(path, IDENTITY, RECORD)
    back = read_checkpoint(path, IDENTITY)
    assert np.array_equal(back.costs, RECORD.costs)
    assert back.asked_sha256 == RECORD.asked_sha256


def test_names_what_differs(tmp_path):
    path = tmp_path / "x.checkpoint"
    write_checkpoint(path, IDENTITY, RECORD)
    other = {**IDENTITY, "options": {"sources": 4, "algorithm": "abc"}}
    with pytest.raises(InputError, match=r"other options: options\.sources"):
        read_checkpoint(path, other)


@pytest.mark.parametrize("damage", [b"", b"\x00\xff", b"{}\n", b"[1]\n", b"not a checkpoint\n1"])
def test_damaged(tmp_path, damage):
    path = tmp_path / "x.checkpoint"
    path.write_bytes(damage)
    with pytest.raises(InputError, match="not a checkpoint"):
        read_checkpoint(path, IDENTITY)


def test_truncated(tmp_path):
    path = tmp_path / "x.checkpoint"
    write_checkpoint(path, IDENTITY, RECORD)
    path.write_bytes(path.read_bytes()[:-8])
    with pytest.raises(InputError, match="damaged"):
        read_checkpoint(path, IDENTITY)


def test_missing(tmp_path):
    with pytest.raises(InputError, match="nothing to resume"):
        read_checkpoint(tmp_path / "x.checkpoint", IDENTITY)


def test_path_keeps_the_whole_name(tmp_path):
    assert checkpoint_path(tmp_path / "a.toml").name == "a.toml.checkpoint"


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("old")
    write_atomically(path, b"new")
    assert path.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.toml"]


def test_a_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_atomically(tmp_path / "none" / "a.toml", b"x")
