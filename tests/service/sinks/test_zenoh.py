"""Sessions and the sink over real Zenoh; the other end uses plain Zenoh, none of our code."""

import json
import threading
import time
from itertools import pairwise

import msgspec
import pytest
import zenoh

from drivers.events import VehicleId
from estimator.errors import InputError
from service.parameters import ParameterRequests
from service.records import Evicted, Published
from service.sinks.zenoh import TogetherSink, ZenohSink
from service.zenoh_session import close_session
from tests.fuzzbee.processes import started
from tests.service.flight_rig import PAPER, Rig
from tests.service.records import status
from tests.service.sessions import (
    assert_without_gaps,
    get,
    heard,
    open_session,
    plain_client,
    plain_listener,
    router,
    service,
    tokens,
    wait_for,
)

ONE, OTHER = VehicleId(7, 1), VehicleId(1, 154)


def zenoh_sink(session, *notify):
    return ZenohSink(session, "test", PAPER, ParameterRequests(), *notify)


def statuses(*vehicles):
    return [Published(vehicle, status("waiting")) for vehicle in vehicles]


def test_a_plain_subscriber_receives_every_attitude(endpoint):
    got = []
    with service(endpoint), plain_client(endpoint) as client:
        client.declare_subscriber("test/1/attitude", got.append)
        statuses = heard(client, "test/1/status")
        wait_for(lambda: len(got) >= 150 and statuses)
    records = [json.loads(sample.payload.to_bytes()) for sample in got]
    assert_without_gaps(records)
    times = [record["time_unix_us"] for record in records]
    assert times == sorted(times)
    assert str(got[0].encoding) == "application/json"
    assert got[0].congestion_control == zenoh.CongestionControl.DROP
    assert not got[0].express
    assert statuses[-1]["imu_message"] == "RAW_IMU"


def test_gets_parameters_and_liveliness(endpoint):
    with service(endpoint), plain_client(endpoint) as client:
        wait_for(lambda: get(client, "test/1/attitude") and get(client, "test/1/status"))
        ((key, attitude),) = get(client, "test/*/attitude")
        assert key == "test/1/attitude"
        assert attitude["schema"] == 1
        assert tokens(client, "test/*/alive") == ["test/1/alive"]

        ((key, profile),) = get(client, "test/1/parameters")
        assert key == "test/1/parameters"
        assert profile["filter"]["gamma"] == 1.0
        change = {"filter": {"gamma": 0.5}, "membership": {"k1": 0.01}}
        ((_, changed),) = get(client, "test/1/parameters", json.dumps(change))
        assert changed == profile | {name: profile[name] | change[name] for name in change}
        assert get(client, "test/1/parameters") == [("test/1/parameters", changed)]
        ((_, whole),) = get(client, "test/1/parameters", json.dumps(profile))
        assert whole == profile


def test_closing_withdraws_the_vehicle(endpoint):
    with plain_listener(endpoint) as listener:
        changes = []
        listener.liveliness().declare_subscriber(
            "test/*/alive", lambda sample: changes.append(sample.kind), history=True
        )
        with service(endpoint):
            wait_for(lambda: changes == [zenoh.SampleKind.PUT])
        wait_for(lambda: changes == [zenoh.SampleKind.PUT, zenoh.SampleKind.DELETE])


@pytest.mark.parametrize("first", [0, 1, 2])
def test_three_default_sessions_find_each_other_with_any_one_listening(endpoint, first):
    """Peers do not relay: the two that came later must reach each other directly."""
    order = [(first + n) % 3 for n in range(3)]
    sessions = {number: open_session(endpoint) for number in order}
    got = {1: [], 2: []}
    for number, samples in got.items():
        sessions[number].declare_subscriber("test/9/attitude", samples.append)
    wait_for(lambda: all(len(list(s.info.peers_zid())) == 2 for s in sessions.values()))
    wait_for(lambda: sessions[0].put("test/9/attitude", b"x") or all(got.values()))
    for session in sessions.values():
        close_session(session)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"listen": ("nonsense",)}, "nonsense"),
        ({"listen": ("tcp/127.0.0.1:99999",), "settings": ()}, "99999"),
        ({"settings": ("mode",)}, "KEY:JSON5"),
        ({"settings": ("no_such_key:1",)}, "unknown key"),
        ({"settings": ("mode:{",)}, "expected"),
        ({"settings": ("listen:" + "[" * 50_000,)}, "more than 4096 lists"),
        ({"config_file": "/no/such/file"}, "/no/such/file"),
        ({"config_file": "/dev/zero"}, "not a file but a pipe, a socket or a device"),
        ({"config_file": "deep.json5"}, "more than 4096 lists"),  # the library's parser overflows
        ({"prefix": "/a"}, "/a"),
        ({"prefix": ""}, "empty"),
    ],
)
def test_unusable_options_are_named_in_one_line(endpoint, changes, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep.json5").write_text("{listen: " + 50_000 * "[")
    with pytest.raises(InputError, match=words) as caught:
        open_session(endpoint, **changes)
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


def test_a_second_service_for_the_same_vehicle_is_noticed(endpoint, session):
    reported = []
    zenoh_sink(session).handle(statuses(ONE))
    second = zenoh_sink(open_session(endpoint), reported.append)
    second.handle(statuses(OTHER))
    assert reported == []
    for _ in range(2):  # reported once
        second.handle(statuses(ONE))
        assert reported == ["test/7"]
    second.close()


def test_a_vehicle_that_is_forgotten_is_withdrawn_and_may_come_back(client, session):
    """One is a component other than the autopilot, which has keys of its own."""
    sink = zenoh_sink(session, pytest.fail)

    def are_alive(*names):
        wait_for(
            lambda: sorted(tokens(client, "test/*/alive")) == [f"test/{n}/alive" for n in names]
        )

    sink.handle(statuses(ONE, OTHER))
    are_alive("1-154", "7")
    sink.handle([Evicted(ONE), Evicted(ONE)])
    are_alive("1-154")
    assert [key for key, _ in get(client, "test/*/status")] == ["test/1-154/status"]
    assert get(client, "test/7/parameters") == []
    sink.handle(statuses(ONE))
    are_alive("1-154", "7")
    published = json.loads(msgspec.json.encode(status("waiting")))
    assert get(client, "test/7/status") == [("test/7/status", published)]


def test_all_attitudes_of_a_tick_come_in_one_put(client, session):
    """It is JSON by vehicle, with the newest attitude of each."""
    vehicles = [VehicleId(1, 1), VehicleId(2, 1), VehicleId(2, 154)]
    record = Rig().fly(2.0).records[-1]
    old = Rig().fly(1.0).records[-1]
    sink = TogetherSink(session, "test", period_s=0.02)
    received = heard(client, "test/attitudes")
    time.sleep(0.3)
    sink.handle(
        [Published(vehicles[0], old), *(Published(vehicle, record) for vehicle in vehicles)]
    )
    sink.handle([])
    wait_for(lambda: received)
    sink.close()
    assert received == [dict.fromkeys(("1", "2", "2-154"), json.loads(msgspec.json.encode(record)))]


KEY = "fuzzbee/1/attitude"


def test_a_router_that_returns_gets_attitudes_again_and_the_loop_never_stopped(endpoint):
    client = ("-m", "client", "-e", endpoint)
    with router(endpoint) as first, started("run", "sim:", "--json", "--rate", "50", *client):
        with plain_client(endpoint) as session:
            seen = heard(session, KEY)
            wait_for(lambda: len(seen) > 20)
        first.kill()
        first.wait()
        gone_s = time.monotonic()
        while True:
            try:
                with router(endpoint), plain_client(endpoint) as session:
                    again = heard(session, KEY)
                    wait_for(lambda seen=again: len(seen) > 20)
                break
            except zenoh.ZError:  # the port is not free again yet
                assert time.monotonic() - gone_s < 120.0
    assert again[0]["sequence"] > seen[-1]["sequence"]
    assert again[-1]["state"] == "running"
    steps = [b["sequence"] - a["sequence"] for a, b in pairwise(again)]
    assert set(steps) == {1}


def test_a_subscriber_that_blocks_costs_the_others_nothing(endpoint):
    release, stuck = threading.Event(), []
    with (
        started("run", "sim:", "--json", "--rate", "200", "-l", endpoint, "-e", endpoint),
        plain_client(endpoint, 60.0) as blocked,
        plain_client(endpoint) as session,
    ):
        blocked.declare_subscriber(KEY, lambda sample: (stuck.append(sample), release.wait()))
        try:
            seen = heard(session, KEY)
            wait_for(lambda: len(seen) > 1500)
        finally:
            release.set()
    assert stuck
    missing = sum(b["sequence"] - a["sequence"] - 1 for a, b in pairwise(seen))
    assert missing < 0.01 * len(seen)
    assert seen[-1]["state"] == "running"
