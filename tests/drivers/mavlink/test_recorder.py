"""What ends up in a tlog, also when the disk or the process does not hold."""

import errno
import logging
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink import mavutil

import drivers
from drivers.events import VehicleId
from drivers.mavlink import recorder as recorder_module
from drivers.mavlink.encoder import FrameEncoder, attitude, heartbeat
from drivers.mavlink.recorder import RETRY_US, SharedRecorder, TlogRecorder, records_of
from estimator.errors import InputError

ROOT = Path(drivers.__file__).parents[1]
UNIX_US = 1_790_000_000_000_000


def test_pymavlink_reads_the_recording(tmp_path):
    frames = FrameEncoder(VehicleId(1, 1))
    with TlogRecorder(tmp_path / "flight.tlog") as recorder:
        recorder.write(records_of(UNIX_US, [frames.frame(heartbeat(2, 3), 0)]))
        recorder.write(records_of(UNIX_US + 1_000_000, []))
        said = [frames.frame(attitude(i, (0.1 * i, 0, 0), (0, 0, 0)), 0) for i in range(3)]
        recorder.write(records_of(UNIX_US + 2_500_000, said))
    log = mavutil.mavlink_connection(str(tmp_path / "flight.tlog"))
    read = []
    while (message := log.recv_match()) is not None:
        read.append((message.get_type(), message._timestamp - UNIX_US * 1e-6))
    log.close()
    assert [kind for kind, _ in read] == ["HEARTBEAT", "ATTITUDE", "ATTITUDE", "ATTITUDE"]
    assert [t for _, t in read] == pytest.approx([0, 2.5, 2.5, 2.5], abs=1e-5)
    assert recorder.lost == 0


def test_an_existing_file_is_continued(tmp_path):
    path = tmp_path / "flight.tlog"
    for part in (b"\xfdfirst", b"\xfesecond"):
        with TlogRecorder(path) as recorder:
            recorder.write(records_of(1, [part]))
    assert (
        path.read_bytes()
        == (1).to_bytes(8, "big") + b"\xfdfirst" + (1).to_bytes(8, "big") + b"\xfesecond"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_reported_once(caplog):
    with TlogRecorder("/dev/full") as recorder, caplog.at_level(logging.WARNING):
        for i in range(100):
            recorder.write(records_of(UNIX_US + i * RETRY_US // 10, [b"frame", b"frame"]))
    assert recorder.lost == 200
    assert len(caplog.records) == 1
    assert "/dev/full" in caplog.text
    assert "No space left" in caplog.text


@pytest.mark.skipif(os.name != "posix", reason="needs resource limits")
def test_half_written_records_are_taken_back(tmp_path):
    """A file size limit cuts a write in two, like a disk that has just filled up."""
    path = tmp_path / "flight.tlog"
    script = (
        "import resource, signal, sys\n"
        "from drivers.mavlink.recorder import TlogRecorder, records_of\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "with TlogRecorder(sys.argv[1]) as recorder:\n"
        "    for i in range(50):\n"
        "        recorder.write(records_of(i, [b'x' * 32]))\n"
        "print(recorder.lost)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, path], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert path.stat().st_size == 25 * 40
    assert int(done.stdout) == 25
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_killed_process_leaves_whole_records(tmp_path):
    path = tmp_path / "flight.tlog"
    script = (
        "import sys\n"
        "from drivers.mavlink.recorder import TlogRecorder, records_of\n"
        "recorder = TlogRecorder(sys.argv[1])\n"
        "while True:\n"
        "    recorder.write(records_of(1, [b'x' * 56] * 3))\n"
        "    if recorder.path.stat().st_size == 64 * 300: print('ready', flush=True)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, path], stdout=subprocess.PIPE, cwd=ROOT
    ) as process:
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(signal.SIGKILL)
    size = path.stat().st_size
    assert size >= 64 * 300
    assert size % 64 == 0


def test_frames_that_could_not_be_handed_over_are_told_once(tmp_path, caplog):
    with TlogRecorder(tmp_path / "flight.tlog") as file:
        recorder = SharedRecorder(file)
        recorder.miss(0)
        assert recorder.is_whole
        assert not caplog.records
        recorder.miss(3)
        recorder.miss(1)
    assert not recorder.is_whole
    assert [record.message for record in caplog.records] == [
        "the recording lacks frames: more arrives than can be taken"
    ]


def test_a_file_is_recorded_to_by_one_program(tmp_path):
    """Who is killed leaves no lock behind; nor does a child that it had."""
    path = tmp_path / "flight.tlog"
    script = (
        "import subprocess, sys\n"
        "from drivers.mavlink.recorder import TlogRecorder\n"
        "recorder = TlogRecorder(sys.argv[1])\n"
        "child = subprocess.Popen(['sleep', '60'], stdout=subprocess.DEVNULL)\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, path], stdout=subprocess.PIPE, cwd=ROOT
    ) as process:
        child = int(process.stdout.readline())
        try:
            with pytest.raises(InputError, match=r"flight.tlog': another program records to it"):
                TlogRecorder(path)
            process.kill()
            process.wait()
            TlogRecorder(path).close()
        finally:
            os.kill(child, signal.SIGKILL)
    with TlogRecorder(path), pytest.raises(InputError, match="another"):
        TlogRecorder(path)  # nor twice by one


def test_a_file_that_is_made_again_is_locked_again(tmp_path, caplog):
    path = tmp_path / "flight.tlog"
    with TlogRecorder(path) as recorder:
        recorder.write(records_of(1, [b"\xfd one"]))
        path.unlink()
        with TlogRecorder(path) as other:
            recorder.write(records_of(2, [b"\xfd two"]))
            assert recorder.lost == 1
            assert "another program records to it" in caplog.text
            other.write(records_of(3, [b"\xfd six"]))
        recorder.write(records_of(4 + RETRY_US, [b"\xfd ten"]))
        with pytest.raises(InputError, match="another"):
            TlogRecorder(path)
    assert path.read_bytes()[8:] == b"\xfd six" + (4 + RETRY_US).to_bytes(8, "big") + b"\xfd ten"


@pytest.mark.parametrize("missing", ["library", "file system"])
def test_without_locks_it_records_all_the_same(missing, tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    if missing == "library":
        monkeypatch.setattr(recorder_module, "fcntl", None)
    else:
        monkeypatch.setattr(recorder_module.fcntl, "flock", no_locks)
    with TlogRecorder(tmp_path / "flight.tlog") as recorder:
        recorder.write(records_of(1, [b"\xfd one"]))
    assert (tmp_path / "flight.tlog").stat().st_size == 13


def test_a_pipe_that_nobody_reads_is_refused(tmp_path):
    """It had been waited for, at the start, by what no signal ends."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=r"cannot record to .*pipe"):
        TlogRecorder(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with TlogRecorder(tmp_path / "pipe") as recorder:
        recorder.write(records_of(1, [b"\xfd one"]))
        assert os.read(reader, 99)[8:] == b"\xfd one"
    os.close(reader)


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot record to"):
        TlogRecorder(tmp_path)
    with pytest.raises(InputError, match="no/such/folder"):
        TlogRecorder(tmp_path / "no/such/folder/flight.tlog")


def test_a_file_that_is_removed_is_made_again(tmp_path, caplog):
    path = tmp_path / "flight.tlog"
    with TlogRecorder(path) as recorder:
        recorder.write(records_of(1, [b"\xfd one"]))
        path.unlink()
        recorder.write(records_of(2, [b"\xfd two"]))
        assert path.read_bytes().endswith(b"\xfd two")
        assert recorder.lost == 0
    assert "was removed" in caplog.text


def test_a_folder_that_is_removed_costs_frames_until_it_is_there_again(tmp_path, caplog):
    folder = tmp_path / "logs"
    folder.mkdir()
    with TlogRecorder(folder / "flight.tlog") as recorder:
        recorder.write(records_of(1, [b"\xfd one"]))
        shutil.rmtree(folder)
        recorder.write(records_of(2, [b"\xfd two"]))
        assert recorder.lost == 1
        assert "No such file" in caplog.text
        folder.mkdir()
        recorder.write(records_of(2 + 10_000_000, [b"\xfd six"]))
        assert (folder / "flight.tlog").read_bytes().endswith(b"\xfd six")
