"""Checkpoints come back as they were, and damaged or foreign ones are refused in one line."""

import json
import os

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
RECORDS = [Record(np.array([1.5, 1 / 3, 7e300]), "ab" * 32), Record(np.array([2.5]), "cd" * 32)]


def test_round_trip(tmp_path):
    path = tmp_path / "x.checkpoint"
    write_checkpoint(path, IDENTITY, RECORDS)
    for back, record in zip(read_checkpoint(path, IDENTITY), RECORDS, strict=True):
        assert np.array_equal(back.costs, record.costs)
        assert back.asked_sha256 == record.asked_sha256


def test_names_what_differs(tmp_path):
    path = tmp_path / "x.checkpoint"
    write_checkpoint(path, IDENTITY, RECORDS)
    other = {**IDENTITY, "options": {"sources": 4, "algorithm": "abc"}}
    with pytest.raises(InputError, match=r"other options: options\.sources"):
        read_checkpoint(path, other)


@pytest.mark.parametrize(
    "damage",
    [b"", b"\x00\xff", b"{}\n", b"[1]\n", b"not a checkpoint\n1", b"[" * 100_000, b"9" * 5000],
)
def test_damaged(tmp_path, damage):
    path = tmp_path / "x.checkpoint"
    path.write_bytes(damage)
    with pytest.raises(InputError, match="not a checkpoint"):
        read_checkpoint(path, IDENTITY)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "x.checkpoint")
    with pytest.raises(InputError, match="not a checkpoint"):
        read_checkpoint(tmp_path / "x.checkpoint", IDENTITY)


@pytest.mark.parametrize("evaluations", [1, 1.5, "3", [3], [], [-1], [2, -1], None])
def test_hostile_counts(tmp_path, evaluations):
    path = tmp_path / "x.checkpoint"
    asked = ["ab"] * (len(evaluations) if isinstance(evaluations, list) else 1)
    header = {"schema": 2, "identity": {}, "evaluations": evaluations, "asked_sha256": asked}
    path.write_bytes(json.dumps(header).encode() + b"\n" + b"\0" * 8)
    with pytest.raises(InputError, match=r"not a checkpoint|damaged|other options"):
        read_checkpoint(path, IDENTITY)


def test_a_nested_identity_is_one_line(tmp_path):
    path = tmp_path / "x.checkpoint"
    deep = b'{"a":' * 900 + b"1" + b"}" * 900
    header = b'{"schema":2,"evaluations":[1],"asked_sha256":[""],"identity":' + deep + b"}\n"
    path.write_bytes(header)
    with pytest.raises(InputError) as raised:
        read_checkpoint(path, IDENTITY)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 500


def test_truncated(tmp_path):
    path = tmp_path / "x.checkpoint"
    write_checkpoint(path, IDENTITY, RECORDS)
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
