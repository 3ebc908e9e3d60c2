"""What compiled code makes of many frames at a time is what Python makes of each, to the last bit.

On recorded logs, on simulated streams with every fault that a reading can have, and on fuzzed ones;
the faults of ``tests/service`` hold both against each other, too.
"""

import os
import random
from pathlib import Path

import numba
import pytest
from hypothesis import given

from drivers.events import Imu, VehicleId
from drivers.logs.log_file import Window
from drivers.logs.tlog import TlogRecords, believe
from drivers.mavlink import usual_frames
from drivers.mavlink.backlog import Arrived
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.encoder import FrameEncoder, Message
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.readings import events_of
from tests.fuzz.cases import DATA, built, fuzzed, stream

LOGS = sorted([*DATA.glob("*.tlog"), *Path(os.environ.get("FUZZBEE_LOGS", DATA)).glob("*.tlog")])
S = 1_000_000
m = mavlink()
is_compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="all is plain Python")


def batches(arrived, rng):
    while arrived:
        size = rng.choice((1, 3, 20, 200))
        yield arrived[:size]
        arrived = arrived[size:]


def compare(arrived, rng, *, references=False):
    """Both ways the same; returns the events, and for how many frames Python was needed."""
    one, many = (MavlinkDecoder(references=references) for _ in range(2))
    expected = [e for us, frame in arrived for e in one.events(frame, us)]
    singly, decode = [], many.events
    many.events = lambda frame, us: singly.append(frame.message_id) or decode(frame, us)
    events = [e for batch in batches(arrived, rng) for e in events_of(many.readings_of(batch))]
    assert [repr(e) for e in by_vehicle(events)] == [repr(e) for e in by_vehicle(expected)]
    return events, singly


def by_vehicle(events):
    """In order for each vehicle."""
    return sorted(events, key=lambda event: event.vehicle)


@is_compiled
@pytest.mark.parametrize("path", dict.fromkeys(LOGS), ids=lambda path: path.name)
def test_a_log_read_in_batches_gives_the_same_events(path):
    records = TlogRecords(Window(path.read_bytes()), MavlinkDecoder().wanted)
    arrived = [Arrived(us, frame) for us, frame in believe(records, 0) if frame is not None]
    compare(arrived, random.Random(1), references=True)
    compare(arrived, random.Random(2))


def imu_frames(rng, message, n=600):
    """A stream with a fault of its own every few dozen readings: (arrival, bytes)."""
    encoder, time_us, boot_us, own = FrameEncoder(VehicleId(7, 1)), 0, 5 * S, []
    reading, second = [0] * 9, [0] * 9
    fault, left = None, 0
    apart_us = rng.choice((0, 2_400_000))  # of the clocks of IMU and ATTITUDE
    for _ in range(n):
        step_us = rng.choice((10_000, 20_000, 20_000, 20_000))
        if left == 0:
            fault, left = rng.choice(FAULTS), rng.randrange(1, 60)
        left -= 1
        jump_us = {"back": -30_000, "again": -step_us, "leap": 9 * S, "reboot": -boot_us}.get(
            fault, 0
        )
        if jump_us:
            left = 0
        time_us += step_us if fault != "late" else 0
        boot_us = max(0, boot_us + (4 if fault == "fast" else 1) * step_us + jump_us)
        if fault == "gap":
            time_us, boot_us, left = time_us + 3 * S, boot_us + 3 * S, 0
        before = reading
        reading = [rng.randrange(-300, 300) for _ in range(9)]
        reading[2] -= 1000
        reading = spoilt(reading, before, fault, rng)
        own.append((time_us, encoder.frame(message(boot_us, reading), 0)))
        if rng.random() < 0.6:
            second = spoilt([rng.randrange(-300, 300) for _ in range(9)], second, fault, rng)
            beside = m.MAVLink_scaled_imu2_message(max(0, boot_us // 1000), *second)
            own.append((time_us + rng.choice((0, 2_000)), encoder.frame(packed(beside), 0)))
        if rng.random() < 0.7:
            rates = [rng.gauss(0.0, 0.3) for _ in range(6)]
            if fault == "nan":
                rates[rng.randrange(6)] = math_nan
            stamp_ms = (boot_us + apart_us - rng.choice((0, 0, 7_000, 2_300_000))) // 1000
            attitude = m.MAVLink_attitude_message(max(0, stamp_ms), *rates)
            own.append((time_us + rng.randrange(9_000), encoder.frame(packed(attitude), 0)))
        if rng.random() < 0.5:
            turned = m.MAVLink_attitude_quaternion_message(boot_us // 1000, 1, 0, 0, 0, 0, 0, 0)
            own.append((time_us, encoder.frame(packed(turned), 0)))
        if rng.random() < 0.1:
            place = m.MAVLink_global_position_int_message(boot_us // 1000, 1, 1, 1, 1, 5, 5, 5, 0)
            own.append((time_us, encoder.frame(packed(place), 0)))
    return own


math_nan = float("nan")
FAULTS = (None, None, None, "back", "again", "leap", "reboot", "late", "fast", "gap", "stuck",
          "gyr", "acc", "mag", "zero", "rail", "spike", "rest", "no field", "nan")  # fmt: skip


def spoilt(reading, before, fault, rng):
    acc, gyr, mag = reading[:3], reading[3:6], reading[6:]
    match fault:
        case "stuck":
            return before
        case "gyr":
            gyr = before[3:6]
        case "acc":
            acc = before[:3]
        case "mag":
            mag = before[6:]
        case "zero":
            acc = [0, 0, 0]
        case "rail":
            gyr = [4400, gyr[1], gyr[2]]
        case "spike":
            gyr = [rng.choice((0, 20_000)), gyr[1], gyr[2]]
        case "rest":
            acc, gyr = [rng.randrange(2), 0, -1000], [0, rng.randrange(2), 0]
        case "no field":
            mag = [0, 0, 0]
    return [*acc, *gyr, *mag]


def packed(message):
    """A message of pymavlink's as ours."""
    message.pack(m.MAVLink(None))
    return Message(type(message).id, message.crc_extra, bytes(message._payload))


def raw(boot_us, reading):
    return packed(m.MAVLink_raw_imu_message(boot_us % 2**32, *reading))


def scaled(boot_us, reading):
    return packed(m.MAVLink_scaled_imu_message(boot_us // 1000, *reading))


def second(boot_us, reading):
    return packed(m.MAVLink_scaled_imu2_message(boot_us // 1000, *reading))


def highres(boot_us, reading):
    acc, gyr, mag = [0.0098 * x for x in reading[:3]], [1e-3 * x for x in reading[3:6]], reading[6:]
    mag, number = [1e-3 * x for x in mag], int(reading[0] % 29 == 0)
    updated = 0x1FF if reading[1] % 3 else 0x3F
    return packed(m.MAVLink_highres_imu_message(
        boot_us, *acc, *gyr, *mag, 1e3, 0, 0, 20, updated, number))  # fmt: skip


@is_compiled
@pytest.mark.parametrize("message", [raw, scaled, highres, second])
@fuzzed(12, 400)
@given(rng=built(lambda rng: rng))
def test_a_stream_with_faults_gives_the_same_events(message, rng):
    reader, own = FrameReader(), imu_frames(rng, message)
    if message is second:
        own = [each for pair in zip(own, imu_frames(rng, raw), strict=False) for each in pair]
    arrived = [Arrived(9 * S + us, frame) for us, data in own for frame in reader.feed(data)]
    compare(arrived, rng)


@is_compiled
@fuzzed(60, 3000)
@given(parts=built(stream))
def test_fuzzed_frames_give_the_same_events(parts):
    reader = FrameReader()
    frames = [frame for part in parts for frame in reader.feed(part)]
    arrived = [Arrived(S + 10_000 * k, frame) for k, frame in enumerate(frames)]
    compare(arrived, random.Random(0))


@is_compiled
def test_nearly_all_frames_of_a_sound_stream_need_no_python():
    rng, encoder = random.Random(3), FrameEncoder(VehicleId(1, 1))
    arrived, reader = [], FrameReader()
    for k in range(1000):
        reading = [rng.randrange(-300, 300) for _ in range(9)]
        attitude = packed(m.MAVLink_attitude_message(20 * k + 7, *[0.01 * (k % 9)] * 6))
        for message in (raw(20_000 * k + 1, reading), attitude):
            (frame,) = reader.feed(encoder.frame(message, 0))
            arrived.append(Arrived(S + 20_000 * k, frame))
    events, singly = compare(arrived, rng)
    assert sum(isinstance(e, Imu) for e in events) == 1000
    assert len(singly) == 2  # the first of each message


@is_compiled
def test_a_table_that_says_something_else_is_believed(monkeypatch):
    entry = usual_frames.IMU_MESSAGES[27]
    monkeypatch.setitem(
        usual_frames.IMU_MESSAGES, 27, entry._replace(vectors=lambda _: ((1.0,) * 3,) * 3)
    )
    reader, encoder = FrameReader(), FrameEncoder(VehicleId(1, 1))
    frames = [reader.feed(encoder.frame(raw(20_000 * k + 1, [k] * 9), 0))[0] for k in range(200)]
    events, _ = compare(
        [Arrived(S + 20_000 * k, f) for k, f in enumerate(frames)], random.Random(1)
    )
    assert all(e.sample.gyr_rad_s == (1.0,) * 3 for e in events if isinstance(e, Imu))
