"""A folder of tlogs, on disks that fill up and are cleared again."""

import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from drivers.mavlink.rotating_recorder import RotatingRecorder

import drivers
from drivers.events import Heartbeat, VehicleId
from drivers.logs.open import open_log
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.recorder import RETRY_US, records_of
from estimator.errors import InputError

ROOT = Path(drivers.__file__).parents[1]
UNIX_US = 1_790_000_000_000_000  # 2026-09-21 14:13:20 UTC
HOUR_US = 3_600_000_000


def frame(encoder=FrameEncoder(VehicleId(1, 1))):  # noqa: B008 - one sender, numbered on
    return encoder.frame(heartbeat(2, 3), 0)


def heartbeats(path):
    with open_log(path) as log:
        return sum(isinstance(event, Heartbeat) for event in log)


def test_a_new_file_by_size_named_by_its_first_record(tmp_path):
    size = 8 + len(frame())
    with RotatingRecorder(tmp_path / "logs", max_file_bytes=10 * size) as recorder:
        for second in range(25):
            recorder.write(records_of(UNIX_US + second * 1_000_000, [frame()]))
            recorder.write(records_of(UNIX_US + second * 1_000_000, []))
    files = sorted((tmp_path / "logs").iterdir())
    assert [file.name for file in files] == [
        "20260921T141320Z.tlog",
        "20260921T141330Z.tlog",
        "20260921T141340Z.tlog",
    ]
    assert [heartbeats(file) for file in files] == [10, 10, 5]
    assert recorder.lost == 0


def test_a_new_file_each_hour_and_when_the_clock_was_set(tmp_path):
    with RotatingRecorder(tmp_path) as recorder:
        for at_us in (0, HOUR_US - 1, HOUR_US, -2 * HOUR_US):
            recorder.write(records_of(UNIX_US + at_us, [frame()]))
    assert len(list(tmp_path.iterdir())) == 3


def test_files_of_one_second_do_not_collide(tmp_path):
    for _ in range(3):
        with RotatingRecorder(tmp_path) as recorder:
            recorder.write(records_of(UNIX_US, [frame()]))
    files = sorted(tmp_path.iterdir())
    assert [heartbeats(file) for file in files] == [1, 1, 1]
    assert {file.name for file in files} == {
        "20260921T141320Z.tlog",
        "20260921T141320Z-2.tlog",
        "20260921T141320Z-3.tlog",
    }


def test_a_name_is_taken_by_whoever_makes_it_first(tmp_path):
    """Also by a link that leads nowhere, which only looks as if nothing were there."""
    (tmp_path / "20260921T141320Z.tlog").symlink_to(tmp_path / "elsewhere.tlog")
    with RotatingRecorder(tmp_path) as recorder:
        recorder.write(records_of(UNIX_US, [frame()]))
    assert heartbeats(tmp_path / "20260921T141320Z-2.tlog") == 1
    assert not (tmp_path / "elsewhere.tlog").exists()


def test_when_no_new_file_can_be_made_the_old_one_goes_on(tmp_path, caplog):
    folder = tmp_path / "logs"
    with RotatingRecorder(folder, max_file_bytes=1) as recorder:
        recorder.write(records_of(UNIX_US, [frame()]))
        moved = tmp_path / "elsewhere"
        folder.rename(moved)  # the card is pulled
        with caplog.at_level(logging.WARNING):
            for n in range(1, 11):
                recorder.write(records_of(UNIX_US + n * RETRY_US // 5, [frame()]))
        folder.mkdir()
        recorder.write(records_of(UNIX_US + 3 * RETRY_US, [frame()]))
    (first,), (second,) = moved.iterdir(), folder.iterdir()
    assert heartbeats(first) == 11
    assert heartbeats(second) == 1
    assert len(caplog.records) == 1
    assert recorder.lost == 0


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="file/logs"):
        RotatingRecorder(tmp_path / "file" / "logs")


FILL = """
import sys
from pathlib import Path
from drivers.mavlink.recorder import RETRY_US
from drivers.mavlink.recorder import records_of
from drivers.mavlink.rotating_recorder import RotatingRecorder
from drivers.events import Heartbeat, VehicleId
from drivers.logs.open import open_log
from drivers.mavlink.encoder import FrameEncoder, heartbeat

folder = Path(sys.argv[1])
ballast = folder / "ballast"
ballast.write_bytes(bytes(100_000))
encoder = FrameEncoder(VehicleId(1, 1))
with RotatingRecorder(folder / "logs", max_file_bytes=40_000) as recorder:
    n = 0
    while recorder.lost < 100:  # the disk is full
        recorder.write(records_of(n * 1000, [encoder.frame(heartbeat(2, 3), 0)]))
        n += 1
    ballast.unlink()
    start = n * 1000 + RETRY_US
    for m in range(100):
        recorder.write(records_of(start + m * 1000, [encoder.frame(heartbeat(2, 3), 0)]))
print(n, recorder.lost)
found = 0
for file in (folder / "logs").iterdir():
    with open_log(file) as log:
        found += sum(isinstance(event, Heartbeat) for event in log)
print(found)
"""


def can_mount():
    probe = "mount -t tmpfs tmpfs /mnt"
    try:
        return not subprocess.run(
            ["unshare", "-Urm", "sh", "-c", probe], capture_output=True, check=False
        ).returncode
    except OSError:
        return False


@pytest.mark.skipif(os.name != "posix" or not can_mount(), reason="needs user namespaces")
def test_a_full_disk_loses_only_what_came_while_it_was_full(tmp_path):
    """A real file system of 200 kB, in a mount namespace of the test's own."""
    script = tmp_path / "fill.py"
    script.write_text(FILL)
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = (
        f"mount -t tmpfs -o size=200k tmpfs '{disk}' && exec '{sys.executable}' '{script}' '{disk}'"
    )
    done = subprocess.run(
        ["unshare", "-Urm", "sh", "-c", mount],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    written, lost, read = map(int, done.stdout.split())
    assert lost == 100
    assert written > 1000
    assert read == written - 100 + 100
    assert "no space left" in done.stderr.lower()
    assert done.stderr.count("the estimate goes on") == 1


def test_a_folder_that_is_removed_is_made_again(tmp_path, caplog):
    folder = tmp_path / "a" / "logs"
    with RotatingRecorder(folder) as recorder:
        recorder.write(records_of(1_700_000_000_000_000, [b"\xfd one"]))
        shutil.rmtree(folder.parent)
        recorder.write(records_of(1_700_000_000_010_000, [b"\xfd two"]))
        (path,) = folder.iterdir()
        assert path.read_bytes().endswith(b"\xfd two")
        assert recorder.lost == 0
    assert "was removed" in caplog.text
