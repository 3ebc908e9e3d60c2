"""What is written never takes the place of what is read; names of any bytes."""

import os
import shutil
from pathlib import Path

import pytest

from tests.fuzzbee.recording import TAKEOFF

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
    """And no half of a new one beside them; a limit on the size of a file stands for the disk."""
    resource = pytest.importorskip("resource")
    files = {o: tmp_path / f"out{s}" for o, s in {"--csv": ".csv", **SUFFIX}.items()}
    printed("replay", TAKEOFF)  # compiles what is lacking
    for file in files.values():
        file.write_text("before")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        for option, out in files.items():
            line = refused("replay", TAKEOFF, option, out, status=1)
            assert line == f"fuzzbee: {option} {out}: File too large, not written"
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
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
def test_what_belongs_to_a_log_or_to_an_output_is_not_overwritten(
    log, beside, command, tmp_path, monkeypatch, refused
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bag").mkdir()
    (tmp_path / log).write_text(TABLE + "".join(f"{0.01 * k},0,0,0,0,0,-1\n" for k in range(9000)))
    (tmp_path / beside).write_text('axes = "frd"\n')
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    line = refused(*command, *(("--cycles", "1") if command[0] == "tune" else ()))
    assert " is also " in line or line.endswith(" is within bag")
    assert before == {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ["", "/", ".."])
@pytest.mark.parametrize("command", [("tune", "sim:", "-o"), ("replay", str(TAKEOFF), "--tum")])
def test_a_file_without_a_name_is_a_folder(command, name, refused):
    """As of a variable of the shell that nobody has set."""
    line = refused(*command, name)
    assert "folder" in line or "Is a directory" in line
