"""Logs may be damaged, shrink, fail, be larger than memory or lack the IMU."""

import errno
import io
import os
import random
import shutil

import pytest

from drivers.events import Imu
from drivers.logs import log_file, ulog
from drivers.logs.log_file import Window, windowed
from drivers.logs.open import open_log
from estimator.errors import InputError
from tests.drivers.logs import test_dataflash, test_tlog, test_ulog
from tests.drivers.logs.writers import (
    DATA,
    DataflashWriter,
    UlogWriter,
    imu_times,
    json_mcap,
    malformed,
    noisy,
)
from tests.drivers.mavlink.messages import ARDUPILOT, PX4, S, heartbeat, m, raw_imu
from tests.programs import run_python


@pytest.mark.parametrize("name", ["px4_hover.ulg", "sub_bluerov.tlog", "copter_reboot.tlog"])
def test_a_log_that_is_truncated_while_it_is_iterated(tmp_path, name):
    """As logrotate's copytruncate does; a mapped file ends the process with SIGBUS."""
    path = tmp_path / name
    shutil.copyfile(DATA / name, path)
    expected = len(imu_times(open_log(path)))
    seen = 0
    for event in open_log(path):
        seen += isinstance(event, Imu)
        if seen == 3 and path.stat().st_size:
            path.write_bytes(b"")
    assert seen == expected > 100


def test_each_record_between_damaged_stretches_is_found(tmp_path):
    """On-board logs' records count if another follows."""
    log, flight = DataflashWriter(), UlogWriter().sensors()
    log.format("IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    data = test_tlog.record(0, heartbeat())
    for k in range(40):
        garbage, time_us = bytes(k % 2 * (1 + k % 12)), S + 20_000 * k
        reading = (0.001 * k, 0.0, 0.0), (0.0, 0.0, -9.8)
        log.write("IMU", time_us, *reading[0], *reading[1])
        log.data += garbage
        flight.sample(time_us, *reading).data += garbage
        data += test_tlog.record(0, raw_imu(time_us, gyr=(k, 0, 0))) + garbage
    (tmp_path / "log.tlog").write_bytes(data)
    paths = {log.save(tmp_path): 20, flight.save(tmp_path): 20, tmp_path / "log.tlog": 40}
    for path, samples in paths.items():
        events = list(open_log(path))
        assert len(imu_times(events)) == samples
        assert malformed(events) in (19, 20)


class Failing(io.BytesIO):
    """A file of which a part can be read before the disk fails."""

    def read(self, size=-1):
        part = super().read(size)
        if not part:
            raise OSError(errno.EIO, "Input/output error")
        return part


def test_a_file_of_which_only_a_part_can_be_read(caplog):
    content = bytes(range(256)) * 40
    window = Window(Failing(content))
    window.move(0)
    window.move(0)
    assert window.data == content
    assert window.is_last
    assert "read no further: Input/output error" in caplog.text


def test_nothing_at_all(tmp_path):
    with pytest.raises(OSError, match="Input/output error"):
        Window(Failing(b"")).move(0)
    with pytest.raises(InputError, match="cannot be read: Is a directory"), windowed(tmp_path):
        pass


READ = """
import resource, sys
from pathlib import Path
from drivers.logs.open import open_log
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for _ in open_log(Path(sys.argv[1])):
    pass
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def sparse_tlog(path):
    path.write_bytes(b"".join(test_tlog.steady(20)))
    os.truncate(path, 1 << 29)


def sparse_ulog(path):
    with path.open("wb") as file:
        file.write(test_ulog.HOVER.read_bytes())
        for _ in range(2000):
            file.write(b"\xff\xffL")
            file.seek(0xFFFF, os.SEEK_CUR)
        file.truncate(file.tell())


@pytest.mark.parametrize(
    ("name", "write"), [("sparse.tlog", sparse_tlog), ("sparse.ulg", sparse_ulog)]
)
def test_a_log_takes_no_memory_for_its_length(tmp_path, name, write):
    write(tmp_path / name)
    done = run_python("-c", READ, tmp_path / name, timeout_s=300)
    assert int(done.stdout) < 100_000  # kB


def noisy_data(data):
    """With stretches of noise, one of which is longer than a piece."""
    third, noise = len(data) // 3, bytes(range(256)) * 700
    first, second, last = data[:third], data[third : 2 * third], data[2 * third :]
    return first + noise + second + b"\xfd\xfe" * 99 + last


def long_dataflash():
    """Between its messages some 60,000 of three bytes, which nobody wants."""
    log = test_dataflash.modern(seconds=20)
    log.format("NIL", "", "", 7)
    return log.data + b"\xa3\x95\x07" * 60_000 + log.data


LOGS = {
    "long.tlog": lambda: b"".join(test_tlog.steady(6000)),
    "long.bin": long_dataflash,
    "long.ulg": test_ulog.HOVER.read_bytes,
}


@pytest.mark.parametrize("harm", [bytes, noisy_data])
@pytest.mark.parametrize("name", LOGS)
def test_a_log_in_pieces_has_the_same_events(tmp_path, name, harm, monkeypatch):
    path = tmp_path / name
    path.write_bytes(harm(LOGS[name]()))
    monkeypatch.setattr(log_file, "READ_SIZE", 70_000)
    pieces = list(open_log(path))
    monkeypatch.setattr(log_file, "READ_SIZE", 1 << 26)
    assert pieces == list(open_log(path))
    assert len(pieces) > 3000


def test_rows_that_come_late_are_put_in_order(tmp_path, monkeypatch):
    """Of a log that is longer than what is held of it; a logger writes what waits."""
    monkeypatch.setattr(ulog, "MOST_HELD", 50)
    rng = random.Random(3)
    times_us = [1_000_000 + 5000 * k for k in range(400)]
    late = sorted(times_us, key=lambda us: us + rng.randrange(200_000))
    log = UlogWriter().sensors()
    for now_us in late:
        log.sample(now_us, noisy(rng, (0, 0, 0)), noisy(rng, (0, 0, -9.8)))
    assert imu_times(open_log(log.save(tmp_path))) == times_us


ATTITUDE = m.MAVLink_attitude_message(1000, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
GROUND_STATION = heartbeat(m.MAV_AUTOPILOT_INVALID, m.MAV_TYPE_GCS)


def attitudes_log(folder, autopilot, *more):
    data = b""
    for k, message in enumerate([heartbeat(autopilot), ATTITUDE, *more] * 20):
        if "time_boot_ms" in message.fieldnames:
            message.time_boot_ms = 1000 + 100 * k
        data += test_tlog.record(k * S // 10, message)
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
    path = attitudes_log(tmp_path, autopilot, *others)
    for command in (["replay", path], ["tune", path, "-o", tmp_path / "x.toml"]):
        line = refused(*command)
        assert "attitudes.tlog: ATTITUDE but no IMU message" in line
        assert all(word in line for word in (*words, "--request-rate"))


def test_an_imu_of_zeros_is_no_missing_message(tmp_path, refused):
    zeros = m.MAVLink_scaled_imu2_message(1000, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    line = refused("replay", attitudes_log(tmp_path, ARDUPILOT, zeros))
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


@pytest.mark.parametrize("write", [lambda folder: attitudes_log(folder, ARDUPILOT), dataflash, bag])
def test_another_system_has_sent_nothing(tmp_path, refused, write):
    line = refused("replay", write(tmp_path), "--system-id", "7")
    assert "no IMU data of system id 7" in line


def test_for_an_on_board_log_the_bit_to_set_is_named(tmp_path, refused):
    assert "IMU bit of LOG_BITMASK" in refused("replay", dataflash(tmp_path))
