"""Whatever comes in: one line with what is wrong, or attitudes. FUZZBEE_FUZZ_LONG=1: longer."""

import json
import random
from contextlib import contextmanager
from importlib import resources

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.events import ClockReset, Imu, VehicleId, Velocity
from drivers.logs.open import open_log
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from estimator.errors import InputError
from estimator.profile import load_profile, merge_profile, parse_profile, profile_to_json
from fuzzbee.replays.score import report_log
from service.pipeline import MAX_VEHICLES, Pipeline
from service.records import Published
from service.sinks.zenoh import _json_object
from tests.drivers.logs.test_dataflash import modern
from tests.flight import banked_flight
from tests.fuzz import cases
from tests.service.flight_rig import ONE, START_US, Rig

PROFILES = [load_profile("paper"), load_profile("imu")]
ULOG, TLOG = cases.clip("px4_hover.ulg", 200_000), cases.clip("sub_bluerov.tlog", 6_000)


@contextmanager
def refused_by_name(name):
    """What is in it ends well, or with one line that has the name."""
    output = name
    try:
        yield
    except InputError as error:
        output = str(error)
    assert name in output
    assert "\n" not in output


def feed(pipeline, events, now_us):
    for event in events:
        pipeline.handle(event)
        if isinstance(event, Imu | ClockReset):
            cases.require_sound(pipeline.tick(now_us))
    cases.require_sound(pipeline.tick(now_us))


@cases.fuzzed(100, 36000)
@given(
    cases.built(cases.stream),
    st.sampled_from(PROFILES),
    st.lists(st.integers(-(10**7), 10**8), max_size=12),
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


@cases.fuzzed(15, 600)
@given(st.data())
def test_a_flight_with_hostile_frames_between(data):
    """The vehicle's own frames go on; what others send must not break its attitude."""
    rig = Rig(data.draw(st.sampled_from(["paper", "imu"])))
    hostile = data.draw(st.lists(cases.built(cases.frame), min_size=1, max_size=20))
    rig.fly(0.5)
    rig.fly(0.5, deliver=lambda own: [hostile.pop(), own] if hostile else [own])
    for record in rig.records:
        cases.require_sound([Published(VehicleId(1, 1), record)])


LOGS = {
    "tlog": lambda rng: cases.damage(TLOG, rng),
    # of hostile frames, stamped anyhow
    "hostile.tlog": lambda rng: b"".join(
        rng.randbytes(8) + cases.frame(rng) for _ in range(rng.randrange(11))
    ),
    "bin": lambda rng: cases.damage(SMALL, rng),
    "any fields.bin": cases.dataflash_formats,
    "ulg": lambda rng: cases.damage(ULOG[: rng.randint(1_000, 40_000)], rng),
    "any fields.ulg": cases.ulog_formats,
}


@pytest.mark.parametrize("kind", LOGS)
@cases.fuzzed(20, 9000)
@given(cases.built(lambda rng: rng))
def test_logs(tmp_path_factory, kind, rng):
    path = tmp_path_factory.getbasetemp() / f"fuzz.{kind.rpartition('.')[2]}"
    content = LOGS[kind](rng)
    path.write_bytes(cases.damage(content, rng) if " " in kind and rng.random() < 0.5 else content)
    pipeline = Pipeline(rng.choice(PROFILES))
    with refused_by_name(path.name):
        for number, event in enumerate(open_log(path)):
            pipeline.handle(event)
            if number % 20 == 0:
                cases.require_sound(pipeline.tick(event.arrival_us))


SMALL = modern(seconds=1).data
WHOLE = [
    ULOG,
    cases.clip("sub_bluerov.tlog", 60_000),
    cases.clip("copter_reboot.tlog", 60_000),
    SMALL,
]


@cases.fuzzed(5, 1500)
@given(st.sampled_from(WHOLE), st.sampled_from(WHOLE), cases.built(lambda rng: rng))
def test_recordings_cut_swapped_and_joined(tmp_path_factory, one, other, rng):
    """Through the report that ``replay --json`` prints."""
    path = tmp_path_factory.getbasetemp() / "fuzz.log"
    path.write_bytes(cases.rearranged(one, rng) + (other if rng.random() < 0.2 else b""))
    reported = []
    with refused_by_name(path.name):
        trace, report = report_log(path, PROFILES[1])
        reported = trace.lines
        msgspec.json.encode(report)
        cases.assert_finite(msgspec.to_builtins(report))
    assert len(reported) < 200
    assert not [line for line in reported if "\n" in line]


TOML = resources.files("estimator").joinpath("profiles", "imu.toml").read_bytes()


@cases.fuzzed(40, 12000)
@given(cases.built(lambda rng: cases.damage(TOML, rng)))
def test_profiles(data):
    text, profiles = data.decode("utf-8", "replace"), []
    with refused_by_name("fuzz.toml"):
        profiles.append(parse_profile(text, "fuzz.toml"))
    assert [parse_profile(text, "fuzz.toml") for _ in profiles] == profiles


SECTIONS = profile_to_json(load_profile("imu"))
BEFORE, BETWEEN, AFTER = 120, 40, 40  # samples


def number(rng):
    """Any magnitude a float has, more often one near the usual; now and then an integer."""
    sign = rng.choice((1.0, 1.0, 1.0, -1.0))
    match rng.randrange(5):
        case 0:
            return sign * 10.0 ** rng.uniform(-324.0, 308.25)
        case 1:
            return rng.choice((0, 1, -1, 10**9, 10**400, 0.0, 5e-324, 1.79e308))
        case _:
            return sign * 10.0 ** rng.uniform(-6.0, 6.0)


def changed(value, rng):
    """A value like the given one, or not at all like it."""
    if rng.random() < 0.05:
        return rng.choice((None, "x", [], {}, True, [1.0, 2.0], {"a": 1}))
    if isinstance(value, bool):
        return rng.random() < 0.5
    if isinstance(value, int | float):
        return number(rng) if rng.random() < 0.2 else value * 2.0 ** rng.uniform(-8.0, 8.0)
    if isinstance(value, list | tuple):
        return [changed(each, rng) for each in value]
    return value


def profile_change(rng):
    """A partial profile: some keys of some sections, with hostile values."""
    partial = {}
    for section in rng.sample(sorted(SECTIONS), rng.randint(1, 3)):
        if not isinstance(SECTIONS[section], dict):  # a key above the sections
            partial[section] = rng.choice(("imu", "imu+attitude", "", number(rng), None, []))
            continue
        keys = sorted(SECTIONS[section])
        chosen = rng.sample(keys, min(len(keys), rng.choice((1, 1, 1, 2, 5, 40))))
        partial[section] = {key: changed(SECTIONS[section][key], rng) for key in chosen}
    if rng.random() < 0.05:
        partial[rng.choice(("", "unknown", "filter"))] = changed({"x": 1}, rng)
    return partial


@pytest.fixture(scope="module")
def flight():
    """Events of a flight with velocity reports."""
    flown = banked_flight(5.0, seed=4)
    behind, events = dict(flown.reports), []
    for k, sample in enumerate(flown.samples):
        arrival_us = START_US + sample.time_us
        events.append([Imu(ONE, arrival_us, sample.time_us, "RAW_IMU", sample)])
        if k in behind:
            events[-1].append(Velocity(ONE, arrival_us, "LOCAL_POSITION_NED", behind[k]))
    return events


@cases.fuzzed(60, 20000)
@given(cases.built(lambda rng: rng))
def test_profiles_installed_in_flight(flight, rng):
    pipeline = Pipeline(load_profile(rng.choice(("imu", "imu", "paper"))))
    published = 0
    for k, events in enumerate(flight[: BEFORE + BETWEEN + AFTER]):
        if k in (BEFORE, BEFORE + BETWEEN):
            answer, output = pipeline.vehicle(ONE).profile, ""
            try:
                payload = json.dumps(profile_change(rng)).encode()
                answer = pipeline.replace_profile(ONE, _json_object(payload))
            except InputError as error:
                output = str(error)
            assert "\n" not in output
            assert pipeline.vehicle(ONE).profile == answer
            assert pipeline.vehicle(ONE).estimator.profile == answer
        for event in events:
            pipeline.handle(event)
        published += cases.require_sound(pipeline.tick(events[0].arrival_us + 1_000))
    assert published == BEFORE + BETWEEN + AFTER
    assert "estimate_not_finite" not in pipeline.vehicle(ONE).rejected


def test_the_cases_reach_both_answers():
    """Half of them or so can be installed, the others cannot: else this tests nothing."""
    base, refused = load_profile("imu"), 0
    for seed in range(300):
        try:
            merge_profile(base, profile_change(random.Random(seed)))
        except InputError:
            refused += 1
    assert 60 < refused < 240, refused
