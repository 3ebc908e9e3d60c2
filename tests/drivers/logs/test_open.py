"""A log is opened by its content, and what is none is refused in one line."""

import gzip
import os

import pytest

from drivers.logs.open import imu_events, open_log
from estimator.errors import InputError
from tests.drivers.logs.reading import DATA, imu_times
from tests.drivers.logs.test_tlog import steady


@pytest.mark.parametrize("name", ["flight.log", "flight.tlog", "flight.bin", "flight"])
def test_the_content_decides_not_the_name(tmp_path, name):
    path = tmp_path / name
    path.write_bytes((DATA / "rover_no_magnetometer.tlog").read_bytes())
    with open_log(path) as log:
        assert len(imu_times(imu_events(log))) == 238


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "the file is empty"),
        (b"# a table\n1,2,3\n" * 100, "not a telemetry log"),
        (b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n", "as text"),
        (b"ULog\x01\x12\x35\x01" + bytes(8), "damaged ULog|no usable IMU"),
        (b"\xa3\x95\x80" + bytes(60), "damaged DataFlash|no usable IMU"),
        (bytes(5000), "not a telemetry log"),
        (gzip.compress(bytes(5000), mtime=0), "a compressed file"),
        (b"".join(each[8:] for each in steady(20)), "MAVLink without time stamps"),
    ],
)
def test_what_cannot_be_used_is_reported_in_one_line(tmp_path, content, complaint):
    path = tmp_path / "thing.log"
    path.write_bytes(content)
    with pytest.raises(InputError, match=complaint) as raised:
        list(imu_events(open_log(path)))
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere.tlog", "no such file"),
        ("", "a folder"),
        *((name, "a pipe, a socket or a device") for name in ("fifo", "/dev/null", "/dev/zero")),
    ],
)
def test_what_is_no_file_or_may_never_end_is_not_opened(tmp_path, name, words):
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(InputError, match=words) as raised:
        open_log(tmp_path / name)
    assert str(raised.value).count(str(tmp_path / name)) == 1
