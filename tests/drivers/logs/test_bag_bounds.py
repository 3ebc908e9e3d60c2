"""Bags of a few bytes that would become gigabytes, and what is in a folder beside a bag."""

import os
import shutil
import sqlite3
import struct
from contextlib import closing
from types import SimpleNamespace

import pytest

from drivers.logs import bag, bag_libraries
from fuzzbee.cli import main
from tests.drivers.logs.test_bag import Bag

lz4 = pytest.importorskip("lz4.frame", reason="the extra 'bags' is not installed")
zstandard = pytest.importorskip("zstandard")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
LARGEST = 200_000
TOO_LARGE = "a chunk or message of more than 64 MB"


@pytest.fixture(autouse=True)
def bounds(monkeypatch):
    monkeypatch.setattr(bag_libraries, "LARGEST", LARGEST)


def put(writing, size):
    """Messages of an IMU: sound ones, then, unless it is 0, one of that size."""
    for k in range(300):
        writing.imu(
            "/imu", 20_000 * k, (1.0, 0, 0, 0), writing.covariances, (0.1, 0, 0), (0, 0, -9.8)
        )
    if size == 0:
        return
    (connection,) = writing.connections.values()
    writing.writer.write(connection, (1 << 60) * 2, bytes(size))


def folder(path, size, mode=None):
    """The folder of a bag with a message of that size; packed in one of rosbags' ways."""
    writing = Bag(path)
    if mode is not None:
        compression = rosbag2.CompressionFormat.ZSTD
        writing.writer.set_compression(getattr(rosbag2.CompressionMode, mode), compression)
    with writing.writer:
        put(writing, size)
    return path


def reported(path, capsys, caplog, status=2):
    assert main(["replay", str(path)]) == status
    return capsys.readouterr().err + caplog.text


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
@pytest.mark.parametrize("mode", [None, "MESSAGE", "STORAGE"])
def test_what_a_folder_holds_is_read_as_far_as_it_is_bounded(
    suffix, mode, tmp_path, capsys, caplog
):
    if (suffix, mode) == (".db3", "STORAGE"):
        pytest.skip("a database is not packed inside")
    path = folder(tmp_path / f"bag{suffix}", 3 * LARGEST, mode)
    is_one_chunk = suffix == ".mcap" and mode != "MESSAGE"
    for each in (path, *path.glob("*.mcap")) if is_one_chunk else (path,):
        output = reported(each, capsys, caplog, status=2 if is_one_chunk else 0)
        caplog.clear()
        assert "read no further: " in output
        assert TOO_LARGE in output or "string or blob too big" in output


@pytest.mark.parametrize("packer", ["bz2", "lz4"])
def test_a_chunk_of_ros_1_is_unpacked_as_far_as_it_is_bounded(packer, tmp_path, capsys, caplog):
    path = tmp_path / "ros1.bag"
    writing = Bag(path)
    compression = type(writing.writer).CompressionFormat[packer.upper()]
    writing.writer.set_compression(compression)
    with writing.writer:
        put(writing, 3 * LARGEST)
    assert path.stat().st_size < LARGEST
    assert TOO_LARGE in reported(path, capsys, caplog)


def test_a_file_that_would_fill_the_disk_is_not_unpacked(tmp_path, capsys, caplog, monkeypatch):
    path = folder(tmp_path / "bag.db3", 50_000, "FILE")
    reported(path, capsys, caplog, status=0)
    usage = SimpleNamespace(free=20_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    assert "unpacked it would fill" in reported(path, capsys, caplog)


def work_out(path):
    (file,) = path.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        database.executescript(
            "DROP TABLE messages;"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp,"
            " data AS (zeroblob(900000000)));"
            "INSERT INTO messages VALUES(1, 1, 1);"
        )


HARMS = {
    "a pipe": (lambda path: os.mkfifo(path / "other"), "other: not a file"),
    "a link": (lambda path: (path / "other").symlink_to("/dev/zero"), "other: not a file"),
    "an index larger than any": (
        lambda path: os.truncate(path / "metadata.yaml", bag.MOST_METADATA + 1),
        "metadata.yaml is larger than any",
    ),
    "worked out": (work_out, "its messages have columns that are worked out"),
}


@pytest.mark.parametrize(("harm", "words"), HARMS.values(), ids=HARMS)
def test_what_is_in_the_folder(harm, words, tmp_path, capsys, caplog):
    """Another folder in it does not matter."""
    path = folder(tmp_path / "bag.db3", 0)
    (path / "other folder").mkdir()
    reported(path, capsys, caplog, status=0)
    harm(path)
    assert words in reported(path, capsys, caplog)


@pytest.mark.parametrize("is_folder", [True, False])
def test_a_hole_in_an_mcap_file_is_not_read_nine_bytes_at_a_time(
    is_folder, tmp_path, capsys, caplog
):
    path = folder(tmp_path / "bag.mcap", 0)
    (file,) = path.glob("*.mcap")
    data = bytearray(file.read_bytes())
    data[-28:-20] = struct.pack("<Q", len(data) - 37)
    with file.open("wb") as hole:
        hole.write(data[:-37])
        hole.seek(1 << 34, os.SEEK_CUR)
        hole.write(data[-37:])
    output = reported(path if is_folder else file, capsys, caplog, status=2 if is_folder else 0)
    assert "nothing where a record should begin" in output


@pytest.mark.parametrize("name", ["bag.db3", "bag.mcap", "ros1.bag"])
def test_of_a_bag_without_an_imu_the_topics_are_listed(name, tmp_path, capsys, caplog):
    writing = Bag(tmp_path / name)
    with writing.writer:
        writing.field("/mag", 1, (1.0, 0.0, 0.0))
    assert "/mag (sensor_msgs/msg/MagneticField)" in reported(tmp_path / name, capsys, caplog)
