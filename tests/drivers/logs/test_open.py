"""A log is opened by its content, and what is none or has no IMU data is refused in one line."""

import gzip
import os

import pytest

from drivers.logs.open import imu_events, open_log
from drivers.mavlink.constants import mavlink
from estimator.errors import InputError
from tests.drivers.logs.reading import DATA, S, imu_times
from tests.drivers.logs.test_tlog import steady
from tests.drivers.logs.writers import DataflashWriter, json_mcap


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


UNIX_US = 1_700_000_000 * S
ARDUPILOT, PX4 = 3, 12
m = mavlink()
ATTITUDE = m.MAVLink_attitude_message(1000, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
GROUND_STATION = m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)


def tlog(folder, autopilot, *more):
    link = m.MAVLink(None, srcSystem=1, srcComponent=1)
    heartbeat = m.MAVLink_heartbeat_message(2, autopilot, 0, 0, 0, 3)
    data = b""
    for k, message in enumerate([heartbeat, ATTITUDE, *more] * 20):
        if "time_boot_ms" in message.fieldnames:
            message.time_boot_ms = 1000 + 100 * k
        data += (UNIX_US + k * S // 10).to_bytes(8, "big") + bytes(message.pack(link))
    path = folder / "attitudes.tlog"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(
    ("autopilot", "others", "words"),
    [
        (ARDUPILOT, [], ["RAW_IMU", "SR*_RAW_SENS", "SET_MESSAGE_INTERVAL of message 27"]),
        (PX4, [], ["HIGHRES_IMU", "mavlink stream -r 50 -s HIGHRES_IMU", "message 105"]),
        (PX4, [GROUND_STATION], ["HIGHRES_IMU"]),
    ],
)
def test_for_a_telemetry_log_the_message_to_ask_for_is_named(
    autopilot, others, words, tmp_path, refused
):
    """It is asked of its autopilot, whatever else speaks under its system id."""
    path = tlog(tmp_path, autopilot, *others)
    for command in (["replay", path], ["tune", path, "-o", tmp_path / "x.toml"]):
        line = refused(*command)
        assert "attitudes.tlog: ATTITUDE but no IMU message" in line
        assert all(word in line for word in (*words, "--request-rate"))


def test_an_imu_of_zeros_is_no_missing_message(tmp_path, refused):
    zeros = m.MAVLink_scaled_imu2_message(1000, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    line = refused("replay", tlog(tmp_path, ARDUPILOT, zeros))
    assert "zero_accelerometer" in line
    assert "ask for" not in line


def dataflash(folder):
    log = DataflashWriter()
    log.format("ATT", "Qccc", "TimeUS,Roll,Pitch,Yaw")
    for k in range(20):
        log.write("ATT", S + k * S // 10, 0.0, 0.0, 1.0)
    return log.save(folder)


def bag(folder):
    return json_mcap(folder / "a.mcap", [("MagneticField", 1, 1, {})])


@pytest.mark.parametrize("write", [lambda folder: tlog(folder, ARDUPILOT), dataflash, bag])
def test_another_system_has_sent_nothing(tmp_path, refused, write):
    line = refused("replay", write(tmp_path), "--system-id", "7")
    assert "no IMU data of system id 7" in line


def test_for_an_on_board_log_the_bit_to_set_is_named(tmp_path, refused):
    assert "IMU bit of LOG_BITMASK" in refused("replay", dataflash(tmp_path))
