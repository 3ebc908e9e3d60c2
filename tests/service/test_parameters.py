"""Profiles replaced while vehicles fly: by many at once, and without a jump in the estimate."""

import json
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import pytest

from drivers.events import VehicleId
from estimator.errors import InputError
from estimator.profile import load_profile
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.records import Message, Replaced
from tests.service.flight_rig import ONE, START_US, attitudes, fed, imu_events
from tests.service.sessions import assert_without_gaps, get, heard, plain_client, service, wait_for
from tests.vocabulary import angle_rad


@pytest.mark.parametrize("name", ["paper", "imu"])
def test_another_profile_goes_on_from_the_same_estimate(name):
    events = imu_events(500)
    pipeline = fed(events[:-1], Pipeline(load_profile(name)))
    vehicle = pipeline.vehicle(ONE)
    before = vehicle.estimator.snapshot
    now_us = START_US + 5_000_000
    (shown,) = attitudes(pipeline.tick(now_us))
    changes = {"filter": {"gamma": 0.0}, "confidence": {"magnetic": 0.2}}
    profile = pipeline.replace_profile(ONE, changes)
    assert vehicle.profile == profile
    assert (profile.filter.gamma, profile.confidence.magnetic) == (0.0, 0.2)
    assert vehicle.estimator.snapshot.core.filter == before.core.filter
    again = vehicle.estimator.attitude(shown.time_boot_us)
    assert angle_rad(shown.q_ned_frd, again.q_ned_frd) < 1e-12
    outputs = pipeline.tick(now_us + 10_000)
    assert outputs[:2] == [Replaced(ONE, profile), Message("vehicle 1: new parameters")]
    assert Replaced(ONE, profile) not in pipeline.tick(now_us + 20_000)
    (after,) = attitudes(outputs)
    assert after.sequence == shown.sequence + 1
    pipeline.handle(events[-1])
    bias = vehicle.estimator.snapshot.core.filter.gyr_bias_rad_s
    if name == "paper":  # the conditioning has a second way to the bias
        assert bias == before.core.filter.gyr_bias_rad_s  # gamma 0: the new profile counts at once


def test_an_unknown_vehicle_has_no_profile_to_replace():
    with pytest.raises(InputError, match="no vehicle 9-1"):
        Pipeline(load_profile("imu")).replace_profile(VehicleId(9, 1), {})


def test_whatever_goes_wrong_in_the_loop_is_an_answer():
    requests = ParameterRequests()

    def replace(vehicle, partial, retuned):
        raise OverflowError("out of range")

    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(requests.ask, ONE, {})
        wait_for(requests._queue.qsize)
        requests.serve(replace)
    with pytest.raises(InputError) as raised:
        answer.result()
    assert str(raised.value) == "the profile cannot be used: OverflowError: out of range"


def nested(depth):
    return b'{"filter": {"gamma": ' + b"[" * depth + b"]" * depth + b"}}"


# The payload, and the words that its answer has
HOSTILE = {
    "megabytes": (b'{"provenance": {"description": "' + b"x" * 3_000_000 + b'"}}', ""),
    "no end": (b"[" * 60_000, "no JSON object"),
    "a list": (b"[1]", "no JSON object"),
    "half an object": (b"{", "no JSON object"),
    "an unknown key": (b'{"filter": {"gama": 1}}', "profile update: unknown key 'gama'"),
    "an unknown section": (b'{"surprise": {}}', "surprise"),
    "no section": (b'{"filter": 3}', "filter"),
    "nothing": (b'{"filter": null}', "filter"),
    "not finite": (b'{"membership": {"k1": NaN}}', "no JSON object"),
    "out of range": (b'{"filter": {"gamma": 1e999}}', "no JSON object"),
    "a long number": (b'{"filter": {"gamma": ' + b"9" * 5000 + b"}}", ""),
    "half a character": (b'{"\\ud800": 1}', "no JSON object"),
    "no text": (b'{"\xff": 1}', "no JSON object"),
    **{f"{depth} deep": (nested(depth), "") for depth in (100, 900, *range(950, 1001, 10), 30_000)},
}


def test_a_hostile_payload_is_answered_with_one_line_and_the_service_goes_on(endpoint):
    with service(endpoint), plain_client(endpoint) as client:
        wait_for(lambda: get(client, "test/1/attitude"))
        ((_, first),) = get(client, "test/1/parameters")
        for name, (payload, words) in HOSTILE.items():
            ((key, value),) = get(client, "test/1/parameters", payload)
            assert key is None, name
            assert 0 < len(value["error"]) < 500, name
            assert "\n" not in value["error"]
            assert words in value["error"], name
        assert get(client, "test/1/parameters")[0][1] == first
        ((_, before),) = get(client, "test/1/attitude")
        wait_for(lambda: get(client, "test/1/attitude")[0][1]["sequence"] > before["sequence"])
        ((_, profile),) = get(client, "test/1/parameters", json.dumps({"filter": {"gamma": 0.5}}))
        assert profile["filter"]["gamma"] == 0.5


def test_replacements_under_load_are_answered_one_by_one(endpoint):
    """Three clients, every second request wrong, at 100 attitudes a second."""
    answers = []

    def replace(number):
        with plain_client(endpoint) as client:
            for turn in range(20):
                gamma = 0.1 * (1 + number) + 0.001 * turn
                if turn % 2:
                    gamma = -gamma
                payload = json.dumps({"filter": {"gamma": gamma}})
                (reply,) = get(client, "test/1/parameters", payload)
                answers.append((gamma, *reply))

    with service(endpoint) as outbox, plain_client(endpoint) as client:
        records = heard(client, "test/1/attitude")
        wait_for(lambda: len(records) > 20)
        with ThreadPoolExecutor(3) as pool:
            list(pool.map(replace, range(3)))
        count = len(records)
        wait_for(lambda: len(records) > count + 20)
        ((_, last),) = get(client, "test/1/parameters")
        assert outbox.dropped == 0
    assert len(answers) == 60
    for gamma, key, value in answers:
        if gamma > 0.0:
            assert key == "test/1/parameters"
            assert value["filter"]["gamma"] == gamma
        else:
            assert key is None
            assert "gamma" in value["error"]
    assert last["filter"]["gamma"] in [gamma for gamma, *_ in answers if gamma > 0.0]
    assert_without_gaps(records)
    # the motion turns at most 3.2 rad/s; a reset of the paper's estimate would jump by 3.1 rad
    for a, b in pairwise(records[20:]):
        passed_s = 1e-6 * (b["time_boot_us"] - a["time_boot_us"])
        assert angle_rad(a["q_ned_frd"], b["q_ned_frd"]) < 1.0 + 3.2 * passed_s
