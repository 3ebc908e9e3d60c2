"""Whatever profile a client puts on a vehicle in flight: an answer, and attitudes go on."""

import json
import random

import pytest
from hypothesis import given

from drivers.events import Imu, Velocity
from estimator.errors import InputError
from estimator.profile import load_profile, merge_profile, profile_to_json
from service.pipeline import Pipeline
from service.sinks.zenoh import _json_object
from tests.flight import banked_flight
from tests.fuzz.cases import built, fuzzed, require_sound
from tests.service.flight_rig import ONE, START_US

WHOLE = profile_to_json(load_profile("imu"))
NEVER = "estimate_not_finite"  # counted, should it happen
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
    for section in rng.sample(sorted(WHOLE), rng.randint(1, 3)):
        if not isinstance(WHOLE[section], dict):  # a key above the sections
            partial[section] = rng.choice(("imu", "imu+attitude", "", number(rng), None, []))
            continue
        keys = sorted(WHOLE[section])
        chosen = rng.sample(keys, min(len(keys), rng.choice((1, 1, 1, 2, 5, 40))))
        partial[section] = {key: changed(WHOLE[section][key], rng) for key in chosen}
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


@fuzzed(60, 20000)
@given(built(lambda rng: rng))
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
        published += require_sound(pipeline.tick(events[0].arrival_us + 1_000))
    assert published == BEFORE + BETWEEN + AFTER
    assert NEVER not in pipeline.vehicle(ONE).rejected


def test_the_cases_reach_both_answers():
    """Half of them or so can be installed, the others cannot: else this tests nothing."""
    base, refused = load_profile("imu"), 0
    for seed in range(300):
        try:
            merge_profile(base, profile_change(random.Random(seed)))
        except InputError:
            refused += 1
    assert 60 < refused < 240, refused
