"""Telemetry logs: real recordings, whole and damaged in named ways."""

import random
from collections import Counter
from statistics import median

import pytest

from drivers.events import ClockReset, Heartbeat, Imu, ReferenceAttitude, Rejected
from drivers.logs.tlog import Tlog
from tests.drivers.logs.writers import DATA, gaps_s, imu_times, malformed, of
from tests.drivers.mavlink.messages import UNIX, S, frame, heartbeat, m, raw_imu

# RAW_IMU of (file, samples, median rate in Hz and worst gap in s on the vehicle's clock, worst
# arrival gap in s, samples with a fresh field); all but the last counted with mavutil.mavlogfile
RECORDINGS = [
    ("copter_reboot.tlog", 457, 2.93, 0.58, 18.79, 457),
    ("rover_no_magnetometer.tlog", 238, 3.85, 0.50, 0.55, 0),
    ("sitl_copter_4hz.tlog", 600, 4.00, 0.25, 0.33, 600),
    ("sitl_copter_takeoff.tlog", 1745, 50.0, 0.120, 0.13, 149),  # 5 repeated
    ("sub_bad_data.tlog", 100, 2.00, 0.78, 1.28, 100),
    ("sub_bluerov.tlog", 121, 2.00, 0.76, 1.06, 121),
    ("sub_on_its_side.tlog", 84, 2.00, 3.50, 6.36, 84),
]


@pytest.mark.parametrize(
    ("name", "samples", "rate_hz", "gap_s", "arrival_gap_s", "fields"),
    RECORDINGS,
    ids=[row[0] for row in RECORDINGS],
)
def test_recordings(name, samples, rate_hz, gap_s, arrival_gap_s, fields):
    events = of(Imu, Tlog(DATA / name), "RAW_IMU")
    gaps = gaps_s(imu_times(events))
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
    (reset,) = of(ClockReset, events)
    assert reset.reason == "reboot"
    assert reset.step_s == pytest.approx(-260.45, abs=0.01)
    attitudes = [event.time_us for event in of(ReferenceAttitude, events)]
    assert attitudes[-1] == pytest.approx(imu_times(events)[-1], abs=0.5 * S)  # on the same line
    assert min(gaps_s(attitudes)) > 0


def test_who_is_in_the_log_and_an_imu_that_is_not_there():
    """It does not count against the other."""
    events = list(Tlog(DATA / "sub_bluerov.tlog"))
    beats = of(Heartbeat, events)
    assert {(*beat.vehicle, beat.autopilot, beat.vehicle_type) for beat in beats} == {(1, 1, 3, 12)}
    refused = {(e.message, e.reason) for e in of(Rejected, events)}
    assert refused == {("SCALED_IMU2", "zero_accelerometer")}


def test_simulated_truth_comes_with_the_time_of_its_imu_message():
    events = list(Tlog(DATA / "sitl_copter_flips.tlog"))
    imus = set(imu_times(events, "RAW_IMU"))
    truths = [e for e in of(ReferenceAttitude, events) if e.source == "sim"]
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


def record(after_us, message):
    return (UNIX + after_us).to_bytes(8, "big") + frame(message)


def steady(count):
    """Records of RAW_IMU at 4 Hz."""
    times_us = range(0, count * S // 4, S // 4)
    return [record(us, raw_imu(10 * S + us, mag=(1, 2, 3))) for us in times_us]


def read(tmp_path, data):
    path = tmp_path / "log.tlog"
    path.write_bytes(data)
    return list(Tlog(path))


def written(number, at, data):
    """Other bytes at a place in one of the records."""

    def harm(records):
        records[number] = records[number][:at] + data + records[number][at + len(data) :]
        return b"".join(records)

    return harm


def with_garbage(records):
    rng = random.Random(7)
    return b"".join(good + rng.randbytes(rng.randrange(1, 300)) for good in records)


HARMS = {
    "garbage": (with_garbage, 20, range(20, 400)),
    "another byte": (written(7, 20, b"\x55"), 19, [1]),
    "cut": (lambda records: b"".join(records)[:-3], 19, [1]),
    **{
        f"begins at {k}": (lambda records, k=k: b"".join(records)[k:], 19, [1]) for k in (3, 11, 30)
    },
    # stamps of the year 382 000 were seen, and none at the start; the samples themselves are good
    "from another age": (written(9, 0, (12 * 10**12 * S).to_bytes(8, "big")), 20, [0]),
    "no age": (written(0, 0, bytes(8)), 20, [0]),
}


@pytest.mark.parametrize(("harm", "samples", "unreadable"), HARMS.values(), ids=HARMS)
def test_damage_costs_itself_alone(tmp_path, harm, samples, unreadable):
    events = read(tmp_path, harm(steady(20)))
    assert len(imu_times(events)) == samples
    assert malformed(events) in unreadable
    assert max(gaps_s(imu_times(events))) <= 0.5
    assert max(gaps_s([event.arrival_us for event in events])) <= 0.5
    assert not of(ClockReset, events)


YEAR_US = 365 * 86_400 * S


@pytest.mark.parametrize(
    ("stamps_us", "used_us"),
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
def test_stamps_of_pauses_and_sessions_are_used_and_garbled_ones_are_not(
    tmp_path, stamps_us, used_us
):
    data = b"".join(record(us, heartbeat()) for us in stamps_us)
    beats = of(Heartbeat, read(tmp_path, data))
    assert [event.arrival_us - UNIX for event in beats] == list(used_us)


@pytest.mark.parametrize("name", ["sub_bad_data.tlog", "copter_reboot.tlog"])
def test_unreadable_frames_are_counted_for_every_reader(name):
    """The autopilot sent a message once a second whose layout has changed since."""
    assert malformed(Tlog(DATA / name)) > 40


def test_a_message_nobody_knows_is_passed_over_whole(tmp_path):
    """Its payload holds what looks like a frame; its record's length counts in the chain."""
    before, inside, after = steady(3)
    body = bytes((len(inside), 0, 0, 0, 1, 1)) + (0xFFFFFF).to_bytes(3, "little") + inside
    unknown = b"\xfd" + body + bytes(2)
    assert 0xFFFFFF not in m.mavlink_map
    events = read(tmp_path, before + before[:8] + unknown + after)
    assert imu_times(events) == [10 * S, 10 * S + S // 2]
    assert not malformed(events)
