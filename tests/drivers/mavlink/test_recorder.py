"""What ends up in tlogs, also when the disk, the process or another program does not hold."""

import errno
import os
import shutil
import signal
import subprocess
import sys

import pytest

from drivers.events import Heartbeat
from drivers.logs.open import open_log
from drivers.mavlink import recorder as recorder_module
from drivers.mavlink import tlog_file
from drivers.mavlink.recorder import RETRY_US, Recorder
from estimator.errors import InputError
from tests.drivers.mavlink.links import Vehicle
from tests.programs import ROOT, largest_file
from tests.service.sessions import wait_for

UNIX_US = 1_790_000_000_000_000  # 2026-09-21 14:13:20 UTC
HOUR_US = 3_600_000_000


frame = Vehicle().heartbeat  # of one sender, numbered on


def heartbeats(path):
    with open_log(path) as log:
        return sum(isinstance(event, Heartbeat) for event in log)


def begun(script, path):
    command = [sys.executable, "-c", script, path]
    return subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "flight.tlog"


# --- one file


def test_an_existing_file_is_continued(path):
    for part in (b"\xfdfirst", b"\xfesecond"):
        with Recorder(path) as recorder:
            recorder.write(1, [part])
    stamp = (1).to_bytes(8, "big")
    assert path.read_bytes() == stamp + b"\xfdfirst" + stamp + b"\xfesecond"


def test_half_written_records_are_taken_back(path, caplog):
    """A limit cuts a write in two, like a disk that is full for a while."""
    with Recorder(path) as recorder:
        with largest_file(1010):
            for i in range(50):
                recorder.write(i * 2_000_000, [b"x" * 32])
            wait_for(lambda: recorder.lost == 25)
        for i in range(10):
            recorder.write(100_000_000 + RETRY_US + i, [b"x" * 32])
    assert path.stat().st_size == (25 + 10) * 40
    assert recorder.lost == 25
    ends = [record.message.rpartition("; ")[2] for record in caplog.records]
    assert ends == ["the estimate goes on", "25 frames are missing"]


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_killed_process_leaves_whole_records(path):
    script = (
        "import sys, time\n"
        "from pathlib import Path\n"
        "from drivers.mavlink.recorder import Recorder\n"
        "recorder, has_rates = Recorder(sys.argv[1]), False\n"
        "while True:\n"
        "    recorder.write(1, [b'x' * 56] * 3)\n"
        "    time.sleep(1e-4)\n"
        "    if not has_rates and Path(sys.argv[1]).stat().st_size >= 64 * 300:\n"
        "        has_rates = True\n"
        "        print('ready', flush=True)\n"
    )
    with begun(script, path) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGKILL)
    size = path.stat().st_size
    assert size >= 64 * 300
    assert size % 64 == 0


def test_what_a_disk_that_stands_still_cannot_take_is_counted(path, monkeypatch, caplog):
    monkeypatch.setattr(recorder_module, "MOST_WAITING_BYTES", 100)
    with Recorder(path) as recorder:
        recorder.write(1, [b"\xfd" * 50] * 3)
        recorder.write(1, [b"\xfd" * 50] * 3)
    assert recorder.lost == 6
    assert not recorder.is_whole
    assert [record.message for record in caplog.records] == [
        "the recording lacks frames: the disk does not keep up"
    ]


def test_a_file_is_recorded_to_by_one_program(path):
    """Who is killed leaves no lock behind; nor does a child that it had."""
    script = (
        "import subprocess, sys\n"
        "from drivers.mavlink.recorder import Recorder\n"
        "recorder = Recorder(sys.argv[1])\n"
        "child = subprocess.Popen(['sleep', '60'], stdout=subprocess.DEVNULL)\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    with begun(script, path) as process:
        child = int(process.stdout.readline())
        try:
            with pytest.raises(InputError, match=r"flight.tlog': another program records to it"):
                Recorder(path)
            process.kill()
            process.wait()
            Recorder(path).close()
        finally:
            os.kill(child, signal.SIGKILL)
    with Recorder(path), pytest.raises(InputError, match="another"):
        Recorder(path)  # nor twice by one


@pytest.mark.parametrize("missing", ["library", "file system"])
def test_without_locks_it_records_all_the_same(missing, path, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    if missing == "library":
        monkeypatch.setattr(tlog_file, "fcntl", None)
    else:
        monkeypatch.setattr(tlog_file.fcntl, "flock", no_locks)
    with Recorder(path) as recorder:
        recorder.write(1, [b"\xfd one"])
    assert path.stat().st_size == 13


def test_a_pipe_that_nobody_reads_is_refused(tmp_path):
    """To wait for its reader would be what no signal ends."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"cannot record to .*pipe"):
        Recorder(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with Recorder(tmp_path / "pipe") as recorder:
        recorder.write(1, [b"\xfd one"])
    assert os.read(reader, 99)[8:] == b"\xfd one"
    assert recorder.is_whole
    os.close(reader)


@pytest.mark.parametrize(
    ("target", "in_folder", "match"),
    [
        ("", False, "cannot record to"),
        ("no/such/folder/flight.tlog", False, "no/such/folder"),
        ("file/logs", True, "file/logs"),
    ],
)
def test_a_file_or_folder_that_cannot_be_written_is_refused(target, in_folder, match, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=match):
        Recorder(tmp_path / target, in_folder=in_folder)


# --- a file that another program changes


@pytest.mark.parametrize("moment", ["before a write", "before the end"])
@pytest.mark.parametrize("what", ["truncated", "removed", "replaced", "changed"])
def test_a_file_that_another_program_damages_is_not_whole(what, moment, path, caplog):
    with Recorder(path) as recorder:
        recorder.write(1, [b"\xfd one"])
        wait_for(lambda: path.stat().st_size == 13)
        assert recorder.is_whole
        if what in ("removed", "replaced"):
            path.unlink()
        contents = {"truncated": b"", "changed": b"longer than it was", "replaced": b"another"}
        if what in contents:
            path.write_bytes(contents[what])
        if moment == "before a write":
            recorder.write(2_000_000, [b"\xfd two"])
    assert not recorder.is_whole
    assert f"was {what}" in caplog.text
    if moment == "before a write" and what in ("truncated", "removed"):
        assert path.read_bytes()[8:] == b"\xfd two"
        assert recorder.lost == 0


def test_a_file_that_is_made_again_is_locked_again(path, caplog):
    with Recorder(path) as recorder:
        recorder.write(1, [b"\xfd one"])
        wait_for(lambda: path.stat().st_size)
        path.unlink()
        with Recorder(path) as other:
            recorder.write(2, [b"\xfd two"])
            wait_for(lambda: recorder.lost == 1 and "another program records to it" in caplog.text)
            other.write(3, [b"\xfd six"])
        recorder.write(4 + RETRY_US, [b"\xfd ten"])
        wait_for(lambda: b"ten" in path.read_bytes())
        with pytest.raises(InputError, match="another"):
            Recorder(path)
    assert path.read_bytes()[8:] == b"\xfd six" + (4 + RETRY_US).to_bytes(8, "big") + b"\xfd ten"


@pytest.mark.parametrize(("begin_us", "again_us"), [(1, 2 + RETRY_US), (9 * RETRY_US, 1)])
def test_a_folder_that_is_removed_costs_frames_until_it_is_there_again(
    begin_us, again_us, tmp_path, caplog
):
    """Also if the host's clock is set back meanwhile."""
    folder = tmp_path / "logs"
    folder.mkdir()
    with Recorder(folder / "flight.tlog") as recorder:
        recorder.write(begin_us, [b"\xfd one"])
        wait_for(lambda: (folder / "flight.tlog").stat().st_size)
        shutil.rmtree(folder)
        recorder.write(begin_us + 1, [b"\xfd two"])
        wait_for(lambda: recorder.lost == 1)
        assert "No such file" in caplog.text
        folder.mkdir()
        recorder.write(again_us, [b"\xfd six"])
    assert (folder / "flight.tlog").read_bytes().endswith(b"\xfd six")


# --- a folder of files


def test_a_new_file_by_size_named_by_its_first_record(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder_module, "MAX_FILE_BYTES", 10 * (8 + len(frame())))
    with Recorder(tmp_path / "logs", in_folder=True) as recorder:
        for second in range(25):
            recorder.write(UNIX_US + second * 1_000_000, [frame()])
            recorder.write(UNIX_US + second * 1_000_000, [])
    assert {file.name: heartbeats(file) for file in (tmp_path / "logs").iterdir()} == {
        "20260921T141320Z.tlog": 10,
        "20260921T141330Z.tlog": 10,
        "20260921T141340Z.tlog": 5,
    }
    assert recorder.is_whole


def test_a_new_file_each_hour_and_when_the_clock_was_set(tmp_path):
    with Recorder(tmp_path, in_folder=True) as recorder:
        for at_us in (0, HOUR_US - 1, HOUR_US, -2 * HOUR_US):
            recorder.write(UNIX_US + at_us, [frame()])
    assert len(list(tmp_path.iterdir())) == 3


def test_a_name_belongs_to_the_first_who_makes_it(tmp_path):
    """Also by a link that leads nowhere, which only looks as if nothing were there."""
    (tmp_path / "20260921T141320Z.tlog").symlink_to(tmp_path / "elsewhere.tlog")
    for number in (2, 3):
        with Recorder(tmp_path, in_folder=True) as recorder:
            recorder.write(UNIX_US, [frame()])
        assert heartbeats(tmp_path / f"20260921T141320Z-{number}.tlog") == 1
    assert not (tmp_path / "elsewhere.tlog").exists()


def test_a_folder_that_is_removed_is_made_again(tmp_path, caplog):
    folder = tmp_path / "a" / "logs"
    with Recorder(folder, in_folder=True) as recorder:
        recorder.write(UNIX_US, [b"\xfd one"])
        wait_for(lambda: folder.exists() and list(folder.glob("*.tlog")))
        wait_for(lambda: next(folder.glob("*.tlog")).stat().st_size)
        shutil.rmtree(folder.parent)
        recorder.write(UNIX_US + 10_000, [b"\xfd two"])
    (path,) = folder.iterdir()
    assert path.read_bytes().endswith(b"\xfd two")
    assert recorder.lost == 0
    assert not recorder.is_whole
    assert "was removed" in caplog.text
