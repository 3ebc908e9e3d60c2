"""Real sessions on free loopback ports; the other end uses plain Zenoh, none of our code."""

import json
import time
from contextlib import contextmanager

import msgspec
import pytest
import zenoh

from drivers.events import VehicleId
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from drivers.simulation.source import SimSource
from estimator.errors import InputError
from estimator.profile import load_profile
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.records import Evicted, Published, StatusRecord
from service.runner import Runner
from service.sinks.sink import Outbox
from service.sinks.zenoh import TogetherSink, ZenohSink
from service.zenoh_session import OpeningSession, ZenohOptions, close_session
from tests.service.flight_rig import Rig

PAPER = load_profile("paper")


def open_session(options):
    """An open session; whoever opened it closes it."""
    return OpeningSession(options).session()


def options(endpoint, **changes):
    """The default session on a port of the test's own."""
    listen = json.dumps([endpoint, "tcp/127.0.0.1:0"])
    return ZenohOptions(connect=(endpoint,), settings=(f"listen/endpoints:{listen}",))._replace(
        **changes
    )


def opened(config, patience_s=60.0):
    """A session of a service that may still be starting."""
    end_s = time.monotonic() + patience_s
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError:
            if time.monotonic() > end_s:
                raise
            time.sleep(0.1)


@contextmanager
def plain_client(endpoint, patience_s=0.0):
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with opened(config, patience_s) as session:
        yield session


def wait_for(condition, timeout_s=60.0):
    end_s = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    assert condition()


@contextmanager
def service(endpoint):
    """The whole service on the built-in vehicle, in a thread of its own."""
    import threading

    requests = ParameterRequests()
    sink = ZenohSink(open_session(options(endpoint)), "test", PAPER, requests)
    with SimSource(SimulatedVehicle(seed=0)) as source, Outbox([sink]) as outbox:
        runner = Runner(source, Pipeline(PAPER), outbox, rate_hz=100.0, requests=requests)
        thread = threading.Thread(target=runner.run)
        thread.start()
        try:
            yield outbox
        finally:
            runner.stop()
            thread.join()
    assert outbox.stuck == []
    assert outbox.unreported == []


def test_a_plain_subscriber_receives_every_attitude(endpoint):
    got, statuses = [], []
    with service(endpoint), plain_client(endpoint) as client:
        client.declare_subscriber("test/1/attitude", got.append)
        client.declare_subscriber("test/1/status", statuses.append)
        wait_for(lambda: len(got) >= 150 and statuses)
    records = [json.loads(sample.payload.to_bytes()) for sample in got]
    sequence = [record["sequence"] for record in records]
    assert sequence == list(range(sequence[0], sequence[0] + len(sequence)))
    times = [record["time_unix_us"] for record in records]
    assert times == sorted(times)
    assert str(got[0].encoding) == "application/json"
    assert got[0].congestion_control == zenoh.CongestionControl.DROP
    assert not got[0].express
    assert json.loads(statuses[-1].payload.to_bytes())["imu_message"] == "RAW_IMU"


def get(session, selector, payload=None):
    """(key, value) of each reply; (None, error) of an error reply."""
    out = []
    for reply in session.get(selector, payload=payload, timeout=60.0):
        if reply.ok is not None:
            out.append((str(reply.ok.key_expr), json.loads(reply.ok.payload.to_bytes())))
        else:
            out.append((None, json.loads(reply.err.payload.to_bytes())))
    return out


def test_gets_parameters_and_liveliness(endpoint):
    with service(endpoint), plain_client(endpoint) as client:
        wait_for(lambda: get(client, "test/1/attitude") and get(client, "test/1/status"))
        ((key, attitude),) = get(client, "test/*/attitude")
        assert key == "test/1/attitude"
        assert attitude["schema"] == 1
        alive = [str(reply.ok.key_expr) for reply in client.liveliness().get("test/*/alive")]
        assert alive == ["test/1/alive"]

        ((key, profile),) = get(client, "test/1/parameters")
        assert key == "test/1/parameters"
        assert profile["filter"]["gamma"] == 1.0
        change = json.dumps({"filter": {"gamma": 0.5}})
        ((_, changed),) = get(client, "test/1/parameters", change)
        assert changed["filter"]["gamma"] == 0.5
        assert changed["membership"] == profile["membership"]
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


@contextmanager
def plain_listener(endpoint):
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        yield session


@pytest.mark.parametrize("first", [0, 1, 2])
def test_three_default_sessions_find_each_other_whoever_listens(endpoint, first):
    """Peers do not relay: the two that came later must reach each other directly."""
    order = [(first + n) % 3 for n in range(3)]
    sessions = {number: open_session(options(endpoint)) for number in order}
    got = {1: [], 2: []}
    for number, samples in got.items():
        sessions[number].declare_subscriber("test/9/attitude", samples.append)
    wait_for(lambda: all(len(list(s.info.peers_zid())) == 2 for s in sessions.values()))

    def both_hear():
        sessions[0].put("test/9/attitude", b"x")
        return all(got.values())

    wait_for(both_hear)
    for session in sessions.values():
        close_session(session)


def test_a_session_finds_one_that_starts_later_and_one_that_restarts(endpoint):
    got = []
    early = open_session(options(endpoint))
    early.declare_subscriber("test/**", got.append)
    for _ in range(2):
        late = open_session(options(endpoint))
        wait_for(lambda session=late: session.put("test/1", b"x") or got)
        got.clear()
        close_session(late)
    close_session(early)
    again = open_session(options(endpoint))
    close_session(again)
    close_session(again)  # twice is once


def test_a_taken_address_is_an_error_only_if_it_was_asked_for(endpoint):
    taken = open_session(ZenohOptions(listen=(endpoint,), connect=(endpoint,)))
    with pytest.raises(InputError, match="in use"):
        open_session(ZenohOptions(listen=(endpoint,), connect=(endpoint,)))
    close_session(open_session(options(endpoint)))
    close_session(taken)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mode": "router"}, "router"),
        ({"listen": ("nonsense",)}, "nonsense"),
        ({"listen": ("tcp/127.0.0.1:99999",), "settings": ()}, "99999"),
        ({"settings": ("mode",)}, "KEY:JSON5"),
        ({"settings": ("no_such_key:1",)}, "unknown key"),
        ({"settings": ("mode:{",)}, "expected"),
        ({"settings": ("listen:" + "[" * 50_000,)}, "more than 4096 lists"),
        ({"config_file": "/no/such/file"}, "/no/such/file"),
        ({"config_file": "/dev/zero"}, "not a file but a pipe, a socket or a device"),
        ({"prefix": "a/*"}, "wildcards"),
        ({"prefix": "/a"}, "/a"),
        ({"prefix": ""}, "empty"),
        ({"mode": "client", "settings": ()}, "Unable to connect"),  # without its router
    ],
)
def test_unusable_options_are_named_in_one_line(endpoint, changes, words):
    with pytest.raises(InputError, match=words.replace("*", ".")) as caught:
        open_session(options(endpoint, **changes))
    assert "\n" not in str(caught.value)
    assert ".rs" not in str(caught.value)


def test_a_configuration_nested_too_deep_is_refused(tmp_path):
    """The library's parser had ended the program for want of stack."""
    file = tmp_path / "deep.json5"
    file.write_text("{listen: " + 50_000 * "[")
    with pytest.raises(InputError, match="more than 4096 lists"):
        open_session(ZenohOptions(config_file=str(file)))


def test_a_configuration_file_is_used(endpoint, tmp_path):
    file = tmp_path / "session.json5"
    file.write_text(
        f'{{mode: "peer", scouting: {{multicast: {{enabled: false}}}}, '
        f'listen: {{endpoints: ["{endpoint}"]}}}}'
    )
    session = open_session(ZenohOptions(config_file=str(file)))
    with plain_client(endpoint):
        pass
    close_session(session)


def test_components_other_than_the_autopilot_have_keys_of_their_own(endpoint, session):
    sink = ZenohSink(session, "test", PAPER, ParameterRequests())
    status = StatusRecord("waiting", None, 0.0, 0.0, {}, 0, 0, 0)
    sink.handle([Published(VehicleId(1, 154), status), Published(VehicleId(7, 1), status)])
    with plain_client(endpoint) as client:
        replies = dict(get(client, "test/*/status"))
    assert replies.keys() == {"test/1-154/status", "test/7/status"}
    assert replies["test/7/status"] == msgspec.json.decode(msgspec.json.encode(status))


def test_a_second_service_for_the_same_vehicle_is_noticed(endpoint, session):
    reported = []
    first = ZenohSink(session, "test", PAPER, ParameterRequests())
    status = StatusRecord("waiting", None, 0.0, 0.0, {}, 0, 0, 0)
    first.handle([Published(VehicleId(7, 1), status)])
    other = open_session(options(endpoint))
    second = ZenohSink(other, "test", PAPER, ParameterRequests(), reported.append)
    second.handle([Published(VehicleId(8, 1), status)])
    assert reported == []
    second.handle([Published(VehicleId(7, 1), status)])
    assert reported == ["test/7"]
    second.handle([Published(VehicleId(7, 1), status)])  # reported once
    assert reported == ["test/7"]
    second.close()


def test_a_vehicle_that_is_forgotten_is_withdrawn_and_may_come_back(endpoint, session):
    one, other = VehicleId(1, 1), VehicleId(2, 1)
    sink = ZenohSink(session, "test", PAPER, ParameterRequests(), pytest.fail)
    status = StatusRecord("lost", None, 0.0, 0.0, {}, 0, 0, 0)

    def alive(client):
        return {str(reply.ok.key_expr) for reply in client.liveliness().get("test/*/alive")}

    with plain_client(endpoint) as client:
        sink.handle([Published(vehicle, status) for vehicle in (one, other)])
        wait_for(lambda: alive(client) == {"test/1/alive", "test/2/alive"})
        sink.handle([Evicted(one), Evicted(one)])
        wait_for(lambda: alive(client) == {"test/2/alive"})
        assert [key for key, _ in get(client, "test/*/status")] == ["test/2/status"]
        assert get(client, "test/1/parameters") == []
        sink.handle([Published(one, status)])
        wait_for(lambda: alive(client) == {"test/1/alive", "test/2/alive"})
        assert [key for key, _ in get(client, "test/1/status")] == ["test/1/status"]


def test_all_attitudes_of_a_tick_come_in_one_put(endpoint, session):
    """It is JSON by vehicle, with the newest attitude of each."""
    received = []
    vehicles = [VehicleId(1, 1), VehicleId(2, 1), VehicleId(2, 154)]
    record = Rig().fly(2.0).records[-1]
    old = Rig().fly(1.0).records[-1]
    sink = TogetherSink(session, "test", period_s=0.02)
    outputs = [Published(vehicles[0], old), *(Published(vehicle, record) for vehicle in vehicles)]
    with plain_client(endpoint) as client:
        client.declare_subscriber("test/attitudes", lambda s: received.append(bytes(s.payload)))
        time.sleep(0.3)
        sink.handle(outputs)
        sink.handle([])
        wait_for(lambda: received)
    sink.close()
    (payload,) = received
    expected = msgspec.json.decode(msgspec.json.encode(record))
    assert json.loads(payload) == {"1": expected, "2": expected, "2-154": expected}
