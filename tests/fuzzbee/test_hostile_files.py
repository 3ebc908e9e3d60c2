"""Files that are none, through the real command line: one line and status 2, or a sound reading."""

import gzip
import os
import random
from pathlib import Path

import pytest

from drivers.logs.open import ULOG_MAGIC
from service.process import load_kernels
from tests.fuzz.cases import dataflash
from tests.fuzzbee.recording import DATA

DATAFLASH = dataflash(400)
ULOG = (DATA / "px4_hover.ulg").read_bytes()[:300_000]
TLOG = (DATA / "rover_no_magnetometer.tlog").read_bytes()


def shuffled(content):
    blocks = [content[at : at + 512] for at in range(0, len(content), 512)]
    random.Random(1).shuffle(blocks)
    return b"".join(blocks)


UNUSABLE = {
    "empty.tlog": b"",
    "one byte.bin": b"\xa3",
    "text.ulg": b"time,roll,pitch\n1,2,3\n" * 1000,
    "nulls.tlog": bytes(300_000),
    "noise.bin": random.Random(1).randbytes(300_000),
    "magic.tlog": b"\xfe" * 100_000,
    "magic.bin": b"\xa3\x95\x80" * 50_000,
    "magic.ulg": ULOG_MAGIC + bytes(9) + b"A" * 100_000,
    "lengths.ulg": ULOG_MAGIC + b"\xff" * 100_000,
    "packed.tlog": gzip.compress(TLOG),
    "head.bin": DATAFLASH[:80],
    "head.ulg": ULOG[:900],
    "tail.bin": DATAFLASH[150:],  # without its IMU's format
}
USABLE = {
    "wrong name.tlog": DATAFLASH,
    "wrong name.bin": ULOG,
    "wrong name.ulg": TLOG,
    "twice.bin": 2 * DATAFLASH,
    "twice.ulg": ULOG + ULOG,
    "another behind.tlog": TLOG + ULOG,
    "cut.tlog": TLOG[:-7],
    "in blocks.tlog": shuffled(TLOG),
    "start time.ulg": ULOG[:8] + b"\xff" * 8 + ULOG[16:],
}


@pytest.fixture(autouse=True, scope="module")
def kernels():
    """Compiled, or ``run`` would print a second line."""
    load_kernels()


NO_FILES = {
    "folder": Path.mkdir,
    "fifo": os.mkfifo,
    "loop": lambda path: path.symlink_to(path),
    "missing": lambda _: None,
    300 * "x" + ".tlog": lambda _: None,
}
MADE = {name: lambda path, name=name: path.write_bytes(UNUSABLE[name]) for name in UNUSABLE}


@pytest.mark.parametrize(
    "verb", ["replay --json", "tune -o out.toml", "run --no-zenoh --speed 1000"]
)
@pytest.mark.parametrize(("name", "make"), [*MADE.items(), *NO_FILES.items()])
def test_what_is_no_log_is_refused_with_one_line(verb, name, make, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    make(Path(name))
    verb, *options = verb.split()
    assert name[:20] in refused(verb, name, *options)  # of a long one no more may be shown
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.parametrize("name", USABLE)
def test_what_is_damaged_or_misnamed_is_read(name, tmp_path, replayed):
    path = tmp_path / name
    path.write_bytes(USABLE[name])
    assert replayed(path)["imu"]["samples"] > 50
