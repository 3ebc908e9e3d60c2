"""Files that are none, damaged or odd, and files that are written, by the real command line."""

import gzip
import os
import random
import re
import shutil
from pathlib import Path

import pytest

from drivers.logs.open import ULOG_MAGIC
from service.process import load_kernels
from tests.drivers.logs.test_dataflash import modern
from tests.drivers.logs.test_tlog import steady
from tests.fuzzbee.recording import DATA, TAKEOFF
from tests.programs import largest_file

DATAFLASH = modern(seconds=8).data
ULOG = (DATA / "px4_hover.ulg").read_bytes()[:300_000]
TLOG = (DATA / "rover_no_magnetometer.tlog").read_bytes()


def shuffled(content):
    blocks = [content[at : at + 512] for at in range(0, len(content), 512)]
    random.Random(1).shuffle(blocks)
    return b"".join(blocks)


NO_FRAME, NO_SAMPLE = "not a telemetry log", "no IMU data that can be used|no usable IMU"
UNUSABLE = {
    "empty.tlog": (b"", "the file is empty"),
    "one byte.bin": (b"\xa3", NO_FRAME),
    "text.ulg": (b"time,roll,pitch\n1,2,3\n" * 1000, NO_FRAME),
    "fmt.log": (b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", "as text"),
    "nulls.tlog": (bytes(300_000), NO_FRAME),
    "noise.bin": (random.Random(1).randbytes(300_000), "no IMU message|no usable IMU"),
    "magic.tlog": (b"\xfe" * 100_000, NO_FRAME),
    "magic.bin": (b"\xa3\x95\x80" * 50_000, NO_SAMPLE),
    "magic.ulg": (ULOG_MAGIC + bytes(9) + b"A" * 100_000, NO_SAMPLE),
    "lengths.ulg": (ULOG_MAGIC + b"\xff" * 100_000, NO_SAMPLE),
    "packed.tlog": (gzip.compress(TLOG), "a compressed file"),
    "head.bin": (DATAFLASH[:80], NO_SAMPLE),
    "head.ulg": (ULOG[:900], NO_SAMPLE),
    "tail.bin": (DATAFLASH[328:], NO_FRAME),  # without its IMU's format
    "frames.tlog": (b"".join(each[8:] for each in steady(20)), "MAVLink without time stamps"),
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


A_DEVICE = "a pipe, a socket or a device|a pipe or a socket|no baud rate"
NO_FILES = {
    "season": (Path.mkdir, "a folder"),
    "fifo": (os.mkfifo, A_DEVICE),
    "loop": (lambda path: path.symlink_to(path), "symbolic links|no such file"),
    **{name: (lambda _: None, A_DEVICE) for name in ("/dev/null", "/dev/zero")},
    "missing": (lambda _: None, "no such file"),
    300 * "x" + ".tlog": (lambda _: None, "File name too long|other sources|no source"),
}
MADE = {
    name: (lambda path, content=content: path.write_bytes(content), words)
    for name, (content, words) in UNUSABLE.items()
}


@pytest.mark.parametrize("verb", ["replay --json", "tune -o x.toml", "run --no-zenoh --speed 1000"])
@pytest.mark.parametrize("name", [*MADE, *NO_FILES])
def test_what_is_no_log_is_refused_with_one_line(verb, name, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    make, words = (MADE | NO_FILES)[name]
    make(Path(name))
    verb, *options = verb.split()
    line = refused(verb, name, *options)
    assert name[:20] in line  # of a long one no more may be shown
    assert line.count(name) <= 1 + name.startswith("/dev/")  # run: how to write a device
    assert re.search(words, line)
    assert not (tmp_path / "x.toml").exists()


@pytest.mark.parametrize("name", USABLE)
def test_what_is_damaged_or_misnamed_is_read(name, tmp_path, replayed):
    path = tmp_path / name
    path.write_bytes(USABLE[name])
    assert replayed(path)["imu"]["samples"] > 50


# --- what is written never takes the place of what is read; names of any bytes

SUFFIX = {"--plot": ".svg", "--mcap": ".mcap", "--parquet": ".parquet", "--tum": ".tum"}


@pytest.mark.parametrize("how", ["itself", "symbolic", "hard"])
@pytest.mark.parametrize("option", ["--csv", "--tum", "--plot", "--mcap", "--parquet"])
def test_no_log_is_overwritten_by_what_is_written_of_it(option, how, tmp_path, refused):
    """A link's other name had been enough to lose the log."""
    log = tmp_path / "flight.tlog"
    shutil.copyfile(TAKEOFF, log)
    before, name = log.read_bytes(), log
    if how != "itself":
        name = tmp_path / f"out{SUFFIX.get(option, '.csv')}"
        name.symlink_to(log) if how == "symbolic" else name.hardlink_to(log)
    line = refused("replay", log, option, name)
    assert log.read_bytes() == before
    if how != "itself":
        assert line == f"fuzzbee: {option} {name}: is also {log}"


def test_on_a_full_disk_the_files_of_before_stay(tmp_path, printed, refused):
    """And no half of a new one beside them."""
    files = {o: tmp_path / f"out{s}" for o, s in {"--csv": ".csv", **SUFFIX}.items()}
    printed("replay", TAKEOFF)  # compiles what is lacking
    for file in files.values():
        file.write_text("before")
    with largest_file(10_000):
        for option, out in files.items():
            line = refused("replay", TAKEOFF, option, out, status=1)
            assert line == f"fuzzbee: {option} {out}: File too large, not written"
    assert [file.read_text() for file in tmp_path.iterdir()] == ["before"] * len(files)


def test_a_name_of_bytes_that_are_no_letters(tmp_path, replayed):
    log = Path(os.fsdecode(os.fsencode(tmp_path) + b"/b\xff.tlog"))
    shutil.copyfile(TAKEOFF, log)
    assert replayed(log)["source"].endswith("b\\udcff.tlog")


TABLE = "time_s,gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s),acc_x (g),acc_y (g),acc_z (g)\n"


@pytest.mark.parametrize(
    ("log", "beside", "command"),
    [
        ("imu.csv", "imu.toml", ("replay", "imu.csv", "--csv", "imu.toml")),
        ("imu.csv", "b", ("replay", "imu.csv", "--csv", "out.csv", "--tum", "./out.csv")),
        ("imu.csv", "imu.toml", ("tune", "imu.csv", "-o", "imu.toml")),
        ("imu.csv", "b.toml", ("tune", "imu.csv", "-o", "imu.csv")),
        ("imu.csv", "b.toml", ("tune", "imu.csv", "-o", "b.toml", "--rrd", "imu.csv")),
        ("imu.csv", "b.toml", ("tune", "imu.csv", "-o", "b.toml", "--rrd", "b.toml")),
        ("imu.csv", "imu.toml", ("run", "imu.csv", "--no-zenoh", "--rrd", "imu.toml")),
        ("a.reference.tlog", "b", ("replay", "a.reference.tlog", "--tum", "a.tlog")),
        ("a.toml.checkpoint", "b", ("tune", "a.toml.checkpoint", "-o", "a.toml")),
        ("bag/a.db3", "bag/metadata.yaml", ("replay", "bag", "--csv", "bag/metadata.yaml")),
        ("bag/a.db3", "bag/metadata.yaml", ("replay", "bag", "--csv", "bag/../bag/a.db3")),
    ],
)
def test_no_file_of_a_log_or_output_is_lost(log, beside, command, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bag").mkdir()
    (tmp_path / log).write_text(TABLE + "".join(f"{0.01 * k},0,0,0,0,0,-1\n" for k in range(9000)))
    (tmp_path / beside).write_text('axes = "frd"\n')
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    line = refused(*command, *(("--cycles", "1") if command[0] == "tune" else ()))
    assert " is also " in line or line.endswith(" is within bag")
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
