"""Files that are none, through the real command line: one line and status 2, or a sound reading."""

import gzip
import json
import os
import random
import struct
from pathlib import Path

import pytest

from drivers.logs.open import ULOG_MAGIC
from fuzzbee.cli import main
from service.process import load_kernels
from tests.fuzzbee.recording import DATA

ULOG = (DATA / "px4_hover.ulg").read_bytes()[:300_000]
TLOG = (DATA / "rover_no_magnetometer.tlog").read_bytes()


def dataflash():
    """A sound DataFlash log of one IMU."""
    columns = b"TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
    data = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 130, 35, b"IMU", b"Qffffff", columns)
    for k in range(400):
        values = struct.pack("<Q6f", 1_000_000 + 20_000 * k, 0.1, 0, 0, 0.01 * k, 0.1, -9.8)
        data += b"\xa3\x95\x82" + values
    return data


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
    "head.bin": dataflash()[:80],
    "head.ulg": ULOG[:900],
    "tail.bin": dataflash()[50:],
}
USABLE = {
    "wrong name.tlog": dataflash(),
    "wrong name.bin": ULOG,
    "wrong name.ulg": TLOG,
    "twice.bin": dataflash() + dataflash(),
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


@pytest.mark.parametrize("name", UNUSABLE)
@pytest.mark.parametrize("verb", ["replay", "tune", "run"])
def test_what_is_no_log_is_refused_with_one_line(verb, name, tmp_path, capfd):
    path = tmp_path / name
    path.write_bytes(UNUSABLE[name])
    options = {
        "replay": ["--json"],
        "tune": ["-o", str(tmp_path / "out.toml")],
        "run": ["--no-zenoh", "--json", "--speed", "1000"],
    }[verb]
    assert main([verb, str(path), *options]) == 2
    out, err = capfd.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("fuzzbee: ")
    assert name in err
    assert not (tmp_path / "out.toml").exists()


@pytest.mark.parametrize("name", USABLE)
def test_what_is_damaged_or_misnamed_is_read(name, tmp_path, capfd):
    path = tmp_path / name
    path.write_bytes(USABLE[name])
    assert main(["replay", str(path), "--json"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["imu"]["samples"] > 50


@pytest.mark.parametrize("verb", ["replay", "tune", "run"])
@pytest.mark.parametrize("name", ["folder", "fifo", "loop", "missing", 300 * "x" + ".tlog"])
def test_what_is_no_file_is_refused_with_one_line(verb, name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)  # a line shows the beginning of what is long
    path = Path(name) if len(name) > 100 else tmp_path / name
    if name == "folder":
        path.mkdir()
    elif name == "fifo":
        os.mkfifo(path)
    elif name == "loop":
        path.symlink_to(path)
    options = {"tune": ["-o", str(tmp_path / "out.toml")], "run": ["--no-zenoh"]}.get(verb, [])
    assert main([verb, str(path), *options]) == 2
    err = capfd.readouterr().err
    assert err.count("\n") == 1
    assert name[:10] in err  # of a long one no more may be shown
