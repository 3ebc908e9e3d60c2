"""Telemetry logs: real recordings, whole and damaged in named ways."""

import random
from collections import Counter
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from drivers.events import ClockReset, Heartbeat, Imu, Malformed, ReferenceAttitude, Rejected
from drivers.logs.tlog import Tlog
from drivers.mavlink.constants import mavlink
from estimator.errors import InputError

DATA = Path(__file__).parents[2] / "data"
S = 1_000_000


def imu_events(path, message):
    return [e for e in Tlog(path) if isinstance(e, Imu) and e.message == message]


def gaps_s(times_us):
    return [(b - a) * 1e-6 for a, b in pairwise(times_us)]


# (file, message, samples, median rate in Hz and worst gap in s on the vehicle's clock, worst
# arrival gap in s, samples with a fresh field); all but the last counted with mavutil.mavlogfile
RECORDINGS = [
    ("copter_reboot.tlog", "RAW_IMU", 457, 2.93, 0.58, 18.79, 457),
    ("rover_no_magnetometer.tlog", "RAW_IMU", 238, 3.85, 0.50, 0.55, 0),
    ("sitl_copter_4hz.tlog", "RAW_IMU", 600, 4.00, 0.25, 0.33, 600),
    ("sitl_copter_takeoff.tlog", "RAW_IMU", 1745, 50.0, 0.120, 0.13, 149),  # 5 repeated
    ("sub_bad_data.tlog", "RAW_IMU", 100, 2.00, 0.78, 1.28, 100),
    ("sub_bluerov.tlog", "RAW_IMU", 121, 2.00, 0.76, 1.06, 121),
    ("sub_on_its_side.tlog", "RAW_IMU", 84, 2.00, 3.50, 6.36, 84),
]


@pytest.mark.parametrize(
    ("name", "message", "samples", "rate_hz", "gap_s", "arrival_gap_s", "fields"),
    RECORDINGS,
    ids=[row[0] for row in RECORDINGS],
)
def test_recordings(name, message, samples, rate_hz, gap_s, arrival_gap_s, fields):
    events = imu_events(DATA / name, message)
    gaps = gaps_s([event.sample.time_us for event in events])
    assert len(events) == samples
    assert 1 / median(gaps) == pytest.approx(rate_hz, rel=0.005)
    assert min(gaps) > 0
    assert max(gaps) == pytest.approx(gap_s, abs=0.006)
    assert max(gaps_s([event.arrival_us for event in events])) == pytest.approx(
        arrival_gap_s, abs=0.006
    )
    assert sum(event.sample.has_mag for event in events) == fields


def test_a_reboot_in_mid_log_is_reported_and_cut_out():
    events = list(Tlog(DATA / "copter_reboot.tlog"))
    (reset,) = [event for event in events if isinstance(event, ClockReset)]
    assert reset.reason == "reboot"
    assert reset.step_s == pytest.approx(-260.45, abs=0.01)
    attitudes = [event.time_us for event in events if isinstance(event, ReferenceAttitude)]
    imus = [event.sample.time_us for event in events if isinstance(event, Imu)]
    assert attitudes[-1] == pytest.approx(imus[-1], abs=0.5 * S)  # both on the same line
    assert min(gaps_s(attitudes)) > 0


def test_who_is_in_the_log():
    beats = {e for e in Tlog(DATA / "sub_bluerov.tlog") if isinstance(e, Heartbeat)}
    assert {(*beat.vehicle, beat.autopilot, beat.vehicle_type) for beat in beats} == {(1, 1, 3, 12)}


def test_an_imu_that_is_not_there_does_not_count_against_the_other():
    events = list(Tlog(DATA / "sub_bluerov.tlog"))
    refused = {(e.message, e.reason) for e in events if isinstance(e, Rejected)}
    assert refused == {("SCALED_IMU2", "zero_accelerometer")}


def test_simulated_truth_comes_with_the_time_of_its_imu_message():
    events = list(Tlog(DATA / "sitl_copter_flips.tlog"))
    imus = {e.sample.time_us for e in events if isinstance(e, Imu) and e.message == "RAW_IMU"}
    truths = [e for e in events if isinstance(e, ReferenceAttitude) and e.source == "sim"]
    # the last SIM_STATE still waits for the IMU message that it belongs to
    assert Counter(truth.message for truth in truths) == {"SIM_STATE": 999, "SIMSTATE": 1000}
    # SCALED_IMU's millisecond clock comes between the two
    nearest = [min(abs(truth.time_us - time_us) for time_us in imus) for truth in truths[::50]]
    assert max(nearest) <= 1000


def test_it_can_be_read_twice_and_used_in_a_with_block():
    with Tlog(DATA / "rover_no_magnetometer.tlog") as log:
        assert list(log) == list(log)
        assert len(log.sha256()) == 64


# --- damage


def record(stamp_us, time_usec):
    dialect = mavlink()
    message = dialect.MAVLink_raw_imu_message(time_usec, 0, 0, -1000, 0, 0, 0, 1, 2, 3)
    return stamp_us.to_bytes(8, "big") + bytes(message.pack(dialect.MAVLink(None, 1, 1)))


def steady(count, stamp_us=1_700_000_000 * S, time_us=10 * S):
    return [record(stamp_us + k * S // 4, time_us + k * S // 4) for k in range(count)]


def read(tmp_path, data):
    path = tmp_path / "log.tlog"
    path.write_bytes(data)
    return list(Tlog(path))


def imu_times(events):
    return [event.sample.time_us for event in events if isinstance(event, Imu)]


def with_garbage(records):
    rng = random.Random(7)
    return b"".join(good + rng.randbytes(rng.randrange(1, 300)) for good in records)


def with_a_flipped_bit(records):
    damaged = bytearray(records[7])
    damaged[20] ^= 0x55
    return b"".join([*records[:7], damaged, *records[8:]])


@pytest.mark.parametrize(
    ("harm", "samples", "malformed"),
    [
        (with_garbage, 20, range(20, 400)),
        (with_a_flipped_bit, 19, [1]),
        (lambda records: b"".join(records)[:-3], 19, [1]),
    ],
)
def test_damage_costs_itself_alone(tmp_path, harm, samples, malformed):
    events = read(tmp_path, harm(steady(20)))
    assert len(imu_times(events)) == samples
    found = sum(event.frames for event in events if isinstance(event, Malformed))
    assert found in malformed


@pytest.mark.parametrize(("number", "stamp_us"), [(9, 12_000_000_000_000 * S), (0, 0)])
def test_a_stamp_from_another_age_is_not_believed(tmp_path, number, stamp_us):
    """The year 382 000 was seen, and none at the start; the sample itself is good."""
    records = steady(20)
    records[number] = stamp_us.to_bytes(8, "big") + records[number][8:]
    events = read(tmp_path, b"".join(records))
    assert gaps_s(imu_times(events)) == [0.25] * 19
    assert max(gaps_s([e.arrival_us for e in events])) <= 0.5
    assert not any(isinstance(event, ClockReset) for event in events)


@pytest.mark.parametrize("cut", [3, 11, 30])
def test_a_log_that_begins_in_mid_record_keeps_its_times(tmp_path, cut):
    events = read(tmp_path, b"".join(steady(20))[cut:])
    assert len(imu_times(events)) == 19
    assert gaps_s(imu_times(events)) == [0.25] * 18
    assert max(gaps_s([e.arrival_us for e in events])) <= 0.5
    assert not any(isinstance(event, ClockReset) for event in events)


YEAR_US = 365 * 86_400 * S


@pytest.mark.parametrize(
    ("stamps_us", "believed_us"),
    [
        ((100, 200, YEAR_US, YEAR_US + 100), (100, 200, YEAR_US, YEAR_US + 100)),
        ((0, S, 600 * S, 601 * S), (0, S, 600 * S, 601 * S)),
        ((0, 60 * S, 120 * S, 180 * S, 181 * S), (0, 60 * S, 120 * S, 180 * S, 181 * S)),
        ((7200 * S, 7201 * S, S, 2 * S), (7200 * S, 7201 * S, S, 2 * S)),
        # garbled ones: forwards by hours, back by half an hour, by a year, the last of all
        ((0, S, 5 * 3600 * S, 2 * S), (0, S, S, 2 * S)),
        ((7200 * S, 7201 * S, 5400 * S, 7202 * S), (7200 * S, 7201 * S, 7201 * S, 7202 * S)),
        ((0, S, YEAR_US, 2 * S), (0, S, S, 2 * S)),
        ((0, S, 3600 * S), (0, S, S)),
    ],
)
def test_pauses_and_sessions_are_believed_and_garbled_stamps_are_not(
    tmp_path, stamps_us, believed_us
):
    dialect, begin_us, data = mavlink(), 1_700_000_000 * S, b""
    for k, us in enumerate(stamps_us):
        beat = dialect.MAVLink_heartbeat_message(2, 3, 0, k, 0, 3)
        data += (begin_us + us).to_bytes(8, "big") + bytes(beat.pack(dialect.MAVLink(None, 1, 1)))
    beats = [event for event in read(tmp_path, data) if isinstance(event, Heartbeat)]
    assert [event.arrival_us - begin_us for event in beats] == list(believed_us)


def test_a_raw_capture_has_no_times(tmp_path):
    path = tmp_path / "flight.raw"
    path.write_bytes(b"".join(item[8:] for item in steady(20)))
    with pytest.raises(InputError, match=r"flight\.raw: MAVLink without time stamps"):
        Tlog(path)


@pytest.mark.parametrize("content", [b"", b"some text, not a log\n" * 500])
def test_what_is_no_log_is_reported_so(tmp_path, content):
    path = tmp_path / "notes.tlog"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"notes\.tlog: "):
        Tlog(path)


@pytest.mark.parametrize("name", ["sub_bad_data.tlog", "copter_reboot.tlog"])
def test_unreadable_frames_are_counted_whoever_wants_them(name):
    """The autopilot sent a message once a second whose layout has changed since."""
    assert sum(isinstance(event, Malformed) for event in Tlog(DATA / name)) > 40


def test_a_message_nobody_knows_is_passed_over_whole(tmp_path):
    """Its payload holds what looks like a frame; its record's length is believed in the chain."""
    before, inside, after = steady(3)
    dialect = mavlink()
    body = bytes((len(inside), 0, 0, 0, 1, 1)) + (0xFFFFFF).to_bytes(3, "little") + inside
    unknown = b"\xfd" + body + bytes(2)
    assert 0xFFFFFF not in dialect.mavlink_map
    events = read(tmp_path, before + before[:8] + unknown + after)
    assert imu_times(events) == [10 * S, 10 * S + S // 2]
    assert not [event for event in events if isinstance(event, Malformed)]
