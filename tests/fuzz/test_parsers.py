"""Whatever comes in: no exception but the one that says what is wrong, attitudes finite and unit.

The fast run takes some hundred cases. FUZZBEE_FUZZ_LONG=1 takes more than 100,000, other ones
each time; a hang shows as a test that does not end.
"""

import json
import math
import struct
from importlib import resources

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import ClockReset, Imu, VehicleId
from drivers.logs.open import open_log
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from estimator.errors import InputError
from estimator.profile import load_profile, parse_profile, profile_to_json
from fuzzbee.replays.log_report import report_log
from service.pipeline import MAX_VEHICLES, Pipeline
from service.records import AttitudeRecord, Published
from service.sinks.zenoh import _json_object
from tests.fuzz.cases import (
    built,
    clip,
    damage,
    damaged,
    dataflash_formats,
    frame,
    fuzzed,
    rearranged,
    stream,
    ulog_formats,
)

PROFILES = [load_profile("paper"), load_profile("imu")]
START_US = 1_700_000_000_000_000
ULOG, TLOG = clip("px4_hover.ulg", 200_000), clip("sub_bluerov.tlog", 6_000)


def check(outputs):
    """Every attitude is finite, of unit length, and JSON."""
    for output in outputs:
        if isinstance(output, Published):
            decoded = json.loads(msgspec.json.encode(output.record), parse_constant=_no_constant)
            if isinstance(output.record, AttitudeRecord):
                assert abs(math.hypot(*decoded["q_ned_frd"]) - 1.0) < 1e-6


def _no_constant(name):
    raise AssertionError(f"{name} is no JSON")


def _says(words, error):
    assert words in str(error)


def feed(pipeline, events, now_us):
    for event in events:
        pipeline.handle(event)
        if isinstance(event, Imu | ClockReset):
            check(pipeline.tick(now_us))
    check(pipeline.tick(now_us))


@fuzzed(100, 36000)
@given(
    built(stream), st.sampled_from(PROFILES), st.lists(st.integers(-(10**7), 10**8), max_size=12)
)
def test_mavlink_bytes(parts, profile, steps):
    reader, gate, decoder = FrameReader(), FrameGate(Policy()), MavlinkDecoder()
    pipeline, now_us = Pipeline(profile), START_US
    for number, part in enumerate(parts):
        now_us += steps[number] if number < len(steps) else 10_000
        for each in reader.feed(part):
            if gate.lets_in(each, "a", now_us):
                feed(pipeline, decoder.events(each, now_us), now_us)
        feed(pipeline, gate.take_refused(now_us), now_us)
        assert len(reader._rest) <= 280
    assert len(pipeline.vehicles) <= MAX_VEHICLES


@fuzzed(15, 600)
@given(st.data())
def test_a_flight_with_hostile_frames_between(data):
    """The vehicle's own frames go on; what others say must not break its attitude."""
    from tests.service.flight_rig import Rig

    rig = Rig(data.draw(st.sampled_from(["paper", "imu"])))
    hostile = data.draw(st.lists(built(frame), min_size=1, max_size=20))
    rig.fly(0.5)
    rig.fly(0.5, deliver=lambda own: [hostile.pop(), own] if hostile else [own])
    for record in rig.records:
        check([Published(VehicleId(1, 1), record)])


def read_log(path, profile):
    pipeline = Pipeline(profile)
    try:
        for number, event in enumerate(open_log(path)):
            pipeline.handle(event)
            if number % 20 == 0:
                check(pipeline.tick(event.arrival_us))
    except InputError as error:
        one_line(path, error)


def read_content(tmp_path_factory, suffix, content):
    path = tmp_path_factory.getbasetemp() / f"fuzz.{suffix}"
    path.write_bytes(content)
    read_log(path, PROFILES[1])


def perhaps_damaged(data, content):
    return data.draw(damaged(content)) if data.draw(st.booleans()) else content


def one_line(path, error):
    text = str(error)
    assert path.name in text
    assert "\n" not in text


@fuzzed(40, 18000)
@given(damaged(TLOG))
def test_telemetry_logs(tmp_path_factory, data):
    read_content(tmp_path_factory, "tlog", data)


@fuzzed(20, 12000)
@given(st.lists(st.tuples(st.integers(0, 2**64 - 1), built(frame)), max_size=10), st.data())
def test_telemetry_logs_of_hostile_frames(tmp_path_factory, records, data):
    path = tmp_path_factory.getbasetemp() / "fuzz.tlog"
    content = b"".join(struct.pack(">Q", stamp) + each for stamp, each in records)
    path.write_bytes(perhaps_damaged(data, content))
    read_log(path, PROFILES[0])


def dataflash():
    """A small DataFlash log: formats of IMU, MAG and ATT, and some rows."""

    def fmt(number, length, name, types, columns):
        head = struct.pack("<BB4s16s64s", number, length, name, types, columns)
        return b"\xa3\x95\x80" + head

    data = fmt(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    data += fmt(130, 3 + 8 + 1 + 24, b"IMU", b"QBffffff", b"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    data += fmt(131, 3 + 8 + 1 + 6, b"MAG", b"QBhhh", b"TimeUS,I,MagX,MagY,MagZ")
    data += fmt(132, 3 + 8 + 6, b"ATT", b"QccC", b"TimeUS,Roll,Pitch,Yaw")
    for k in range(12):
        time_us = 1_000_000 + 20_000 * k
        data += b"\xa3\x95\x82" + struct.pack("<QB6f", time_us, 0, 0.1, 0, 0, 0, 0.1, -9.8)
        data += b"\xa3\x95\x83" + struct.pack("<QB3h", time_us, 0, 200, 10, 400)
        data += b"\xa3\x95\x84" + struct.pack("<QhhH", time_us, 100, 200, 300)
    return data


@fuzzed(20, 8000)
@given(damaged(dataflash()))
def test_dataflash_logs(tmp_path_factory, data):
    read_content(tmp_path_factory, "bin", data)


@fuzzed(20, 8000)
@given(built(dataflash_formats), st.data())
def test_dataflash_logs_of_any_fields(tmp_path_factory, content, data):
    read_content(tmp_path_factory, "bin", perhaps_damaged(data, content))


@fuzzed(5, 2000)
@given(built(lambda rng: damage(ULOG[: rng.randint(1_000, len(ULOG))], rng)))
def test_ulogs(tmp_path_factory, data):
    read_content(tmp_path_factory, "ulg", data)


@fuzzed(20, 8000)
@given(built(ulog_formats), st.data())
def test_ulogs_of_any_fields(tmp_path_factory, content, data):
    read_content(tmp_path_factory, "ulg", perhaps_damaged(data, content))


WHOLE = [ULOG, clip("sub_bluerov.tlog", 60_000), clip("copter_reboot.tlog", 60_000), dataflash()]


@fuzzed(5, 1500)
@given(st.sampled_from(WHOLE), st.sampled_from(WHOLE), built(lambda rng: rng))
def test_recordings_cut_swapped_and_joined(tmp_path_factory, one, other, rng):
    """Through the report that ``replay --json`` prints."""
    path = tmp_path_factory.getbasetemp() / "fuzz.log"
    path.write_bytes(rearranged(one, rng) + (other if rng.random() < 0.2 else b""))
    told = []
    try:
        report = report_log(path, PROFILES[1], notify=told.append)
    except InputError as error:
        one_line(path, error)
    else:
        json.loads(msgspec.json.encode(report), parse_constant=_no_constant)
    assert len(told) < 200
    assert not [line for line in told if "\n" in line]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=12,
)


@st.composite
def profile_changes(draw):
    """A partial profile with real keys and any values."""
    whole = msgspec.to_builtins(profile_to_json(PROFILES[1]))
    partial = {}
    for section in draw(st.lists(st.sampled_from(sorted(whole)), max_size=3)):
        fields = whole[section]
        if not isinstance(fields, dict):  # a key above the sections
            partial[section] = draw(st.just(fields) | JSON)
            continue
        keys = draw(st.lists(st.sampled_from(sorted(fields)), max_size=4)) if fields else []
        partial[section] = {key: draw(st.just(fields[key]) | JSON) for key in keys}
    return partial


@fuzzed(30, 4000)
@given(st.one_of(profile_changes(), st.dictionaries(st.text(max_size=8), JSON, max_size=3)))
def test_parameters_put_on_zenoh(partial):
    from tests.service.streams import ONE, imu_events

    pipeline = Pipeline(PROFILES[1])
    events = imu_events(6)
    for event in events[:3]:
        pipeline.handle(event)
    try:
        payload = json.dumps(partial).encode()
        pipeline.replace_profile(ONE, _json_object(payload))
    except InputError:
        assert pipeline.vehicle(ONE).profile == PROFILES[1]
    for event in events[3:]:
        pipeline.handle(event)
        check(pipeline.tick(event.arrival_us))


@fuzzed(20, 19000)
@given(st.binary(max_size=200))
def test_payloads_that_are_no_json(payload):
    try:
        assert isinstance(_json_object(payload), dict)
    except InputError as error:
        _says("payload", error)


TOML = resources.files("estimator").joinpath("profiles", "imu.toml").read_bytes()


@fuzzed(40, 12000)
@given(damaged(TOML))
def test_profiles(data):
    try:
        profile = parse_profile(data.decode("utf-8", "replace"), "fuzz.toml")
    except InputError as error:
        _says("fuzz.toml", error)
    else:
        assert parse_profile(data.decode("utf-8", "replace"), "fuzz.toml") == profile
