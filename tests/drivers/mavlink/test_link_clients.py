"""Who is let in when many send over real sockets, and what is left out."""

import contextlib
import socket
import time

import pytest

from drivers.endpoint import parse_endpoint
from drivers.events import Heartbeat, Imu, Malformed, Shed, VehicleId
from drivers.mavlink import connection
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import Policy
from drivers.mavlink.recorder import Recorder
from drivers.mavlink.signing import SigningCheck
from drivers.mavlink.transports.tcp import MOST_TCP_CLIENTS
from drivers.mavlink.transports.udp import Udp
from tests.drivers.mavlink.links import Vehicle, collect, count, tcp_link, udp_link, udp_sender
from tests.drivers.mavlink.messages import only
from tests.fuzzbee.processes import free_port

pytestmark = pytest.mark.usefixtures("nothing_leaks")


def ours(events):
    """How many samples there are of the first vehicle."""
    return sum(event.vehicle == VehicleId(1, 1) for event in only(Imu, events))


@pytest.mark.parametrize("noise", [b"", b"\0"], ids=["silent", "babbling"])
def test_idle_clients_give_way_to_a_vehicle_and_it_does_not_to_them(noise, caplog):
    """Idle clients go first, in any order of arrival; that is logged once a minute at most."""
    with tcp_link() as (link, connect):
        idle = [connect() for _ in range(MOST_TCP_CLIENTS)]
        for client in idle:
            client.sendall(noise)
        idle += [connect() for _ in range(8)]
        flying, vehicle = connect(), Vehicle(1)
        collect(link, count(Imu, 2), lambda: flying.sendall(vehicle.imu()))
        idle += [connect() for _ in range(2 * MOST_TCP_CLIENTS)]
        collect(link, count(Imu, 2), lambda: flying.sendall(vehicle.imu()))
    lines = [record.message for record in caplog.records if "is dropped" in record.message]
    assert len(lines) == 1


@pytest.mark.parametrize(
    ("hosts", "sent", "host", "is_let_in"),
    [
        (range(2, 34), Vehicle.heartbeat, 1, True),  # without an IMU they hold no place
        ([1] * 32, Vehicle.imu, 2, True),  # who has most slots gives one to another host
        ([1] * 32, Vehicle.imu, 1, False),  # but not to itself
    ],
)
def test_who_sends_imu_data_holds_its_place(hosts, sent, host, is_let_in):
    assert len(hosts) == MOST_TCP_CLIENTS
    with tcp_link("0.0.0.0") as (link, connect):
        clients = {connect(f"127.0.0.{each}"): Vehicle(2 + n) for n, each in enumerate(hosts)}
        flying = Vehicle(1)

        def send():
            for client, vehicle in clients.items():
                with contextlib.suppress(OSError):  # one of them may have given way
                    client.sendall(vehicle.imu() if vehicle is flying else sent(vehicle))

        def are_all_there(events):
            return len({each.vehicle for each in only(Imu | Heartbeat, events)}) == MOST_TCP_CLIENTS

        collect(link, are_all_there, send)
        clients[late := connect(f"127.0.0.{host}")] = flying
        if is_let_in:
            collect(link, lambda events: ours(events) > 9, send)
        else:
            link.drain(0.1)
            assert late.recv(1) == b""
            collect(link, are_all_there, send)


@pytest.mark.parametrize(
    "content",
    [
        b"\xfe" * 64_000,  # a frame may begin at each byte
        b"\xfd\xff\0\0\0\1\1" * 9_000,
        b"".join(Vehicle(n).heartbeat() for n in range(2, 252)) * 12,
        b"",
    ],
    ids=["magic", "nested", "heartbeats", "empty"],
)
@pytest.mark.parametrize("has_imu", [False, True])
def test_large_datagrams_of_another_keep_no_vehicle_out(content, has_imu):
    """They cost as many packets as they may hold frames, also of who sends an IMU's as well."""
    vehicle, other = Vehicle(1), Vehicle(2)
    with udp_link() as (link, flying), udp_sender(flying.getpeername()[1]) as flood:

        def fly():
            vehicle._time_us = time.monotonic_ns() // 1000  # a busy computer is no slow clock
            flying.send(vehicle.imu())

        def both():
            fly()
            if has_imu:
                flood.send(other.imu())

        collect(link, count(Imu, 6), both)
        before, events, begun_s = link.dropped, [], time.monotonic()
        for _ in range(40):
            for _ in range(5):
                flood.send(content)
            fly()
            events += link.drain(0.01)

        taken = lambda found: ours(events + found) + link.shed + link.lost  # noqa: E731
        # on a busy computer more is let in, by time
        rate_hz = connection.IMU_PACKETS_HZ if has_imu else connection.PACKETS_HZ
        each = min(1 + len(content) // connection.FRAME_BYTES, rate_hz)
        let_in = 2 + rate_hz * (1.0 + time.monotonic() - begun_s) / each
        refused = lambda: not content or link.dropped - before + link.lost >= 200 - let_in  # noqa: E731
        events += collect(link, lambda found: taken(found) >= 36 and refused())
        assert ours(events) > 8


def test_no_sample_is_refused_after_a_stop(monkeypatch):
    """A sender has an IMU by when its packets came, not by when they are read: all are."""
    monkeypatch.setattr(connection, "IMU_COUNTS_S", 0.1)
    vehicle = Vehicle(1)
    with udp_link() as (link, wire):
        collect(link, count(Imu, 2), lambda: wire.send(vehicle.imu()))
        for _ in range(400):
            wire.send(vehicle.imu())
        time.sleep(0.3)
        collect(link, count(Imu, 400))
        assert (link.shed, link.dropped, link.lost) == (0, 0, 0)
        time.sleep(0.3)
        for _ in range(400):
            wire.send(vehicle.heartbeat())
        collect(link, lambda _: link.dropped > 0)
        assert 150 <= link.dropped <= 200  # a budget of one second, and what time has added


def test_only_a_full_queue_leaves_samples_out_and_the_newest_stay(tmp_path, monkeypatch):
    """Each is taken or counted, what is sent once stays, and all are in the recording."""
    path, one, two = tmp_path / "flight.tlog", Vehicle(1), Vehicle(2)
    monkeypatch.setattr("drivers.mavlink.link.MOST_WAITING", 100)
    with Recorder(path) as recorder, udp_link(recorder) as (link, sender):
        sent = [each.imu() for _ in range(150) for each in (one, two)]
        sent.insert(20, two.heartbeat())
        for frame in sent:
            sender.send(frame)
        events = collect(link, count(Heartbeat))
        events += collect(
            link, lambda found: one._time_us in [e.boot_us for e in only(Imu, events + found)]
        )
        time.sleep(0.3)
        events += link.drain(0.0)
        shed = link.shed
    taken = len(only(Imu, events))
    assert shed > 100
    assert abs(taken + shed - 300) <= 2  # a first sample waits for its second
    assert sum(each.samples for each in only(Shed, events)) == shed
    assert len(path.read_bytes()) == sum(map(len, sent)) + 8 * 301
    assert recorder.is_whole


def test_the_recording_holds_the_frames_as_they_came_and_what_is_none_is_counted(tmp_path):
    vehicle, path = Vehicle(), tmp_path / "flight.tlog"
    frames = [vehicle.heartbeat(), *(vehicle.imu() for _ in range(20))]
    with Recorder(path) as recorder, udp_link(recorder) as (link, sender):
        sender.send(b"GET / HTTP/1.1\r\n\r\n" + bytes(range(256)))
        for frame in frames:
            sender.send(frame)
        events = collect(link, lambda events: count(Imu, 20)(events) and count(Malformed)(events))
    arrivals_us = [event.arrival_us for event in only(Heartbeat | Imu, events)]
    stamped = zip(arrivals_us, frames, strict=True)
    assert path.read_bytes() == b"".join(us.to_bytes(8, "big") + frame for us, frame in stamped)


def test_a_recording_begins_with_the_port_s_opening_and_not_with_the_first_look(tmp_path):
    """More comes than the system keeps for a socket, before anybody drains; nor ends with that."""
    path, sent, vehicle, stamp = tmp_path / "flight.tlog", b"", Vehicle(), 8
    with Recorder(path) as recorder, udp_link(recorder) as (link, sender):
        for number in range(12_000):
            frame = vehicle.imu()
            if number == 11_995:
                link.drain(0.0)
            sender.send(frame)
            sent += bytes(stamp) + frame
            if number % 500 == 0:
                time.sleep(0.05)
        lost = link.lost
    assert lost == 0
    assert path.stat().st_size == len(sent)


def test_what_a_link_hands_out_is_in_the_file_of_stamps(tmp_path):
    """A crash right afterwards lets nobody send it again: neither known vehicles nor new ones."""
    key, file = bytes(range(32)), tmp_path / "signing.json"
    policy = Policy(signing=SigningCheck(key, file))
    now_us, sent = time.time_ns() // 1000, []
    with udp_link(policy=policy) as (link, wire):
        for number in range(1, 41):
            one = FrameEncoder(VehicleId(number, 1), key).frame(heartbeat(2, 3), now_us)
            sent += FrameReader().feed(one)
            wire.send(one)
        collect(link, count(Heartbeat, 40))
        after = SigningCheck(key, file)
    assert {after.refusal(frame, now_us) for frame in sent} == {"replayed"}


def test_an_imu_that_is_silent_for_long_gives_way_to_a_new_client(monkeypatch):
    vehicle = Vehicle(1)
    with tcp_link() as (link, connect):
        for client, other in [(connect(), Vehicle(n)) for n in range(2, MOST_TCP_CLIENTS + 2)]:
            client.sendall(other.imu())
        collect(link, count(Imu, MOST_TCP_CLIENTS))
        monkeypatch.setattr("drivers.mavlink.transports.tcp.LONG_SILENCE_S", 0.0)
        flying = connect()
        collect(link, count(Imu), lambda: flying.sendall(vehicle.imu()))


def test_of_too_many_senders_the_one_silent_for_longest_is_answered_no_more(monkeypatch):
    monkeypatch.setattr("drivers.mavlink.transports.udp.MOST_UDP_PEERS", 2)
    port = free_port(socket.SOCK_DGRAM)
    transport = Udp(parse_endpoint(f"udpin:{port}"))
    with contextlib.closing(transport), udp_sender(port) as a, udp_sender(port) as b:
        transport.open()
        with udp_sender(port) as c:
            for each in (a, b, a, c):
                each.send(b"something")
                assert any(transport.receive(0.05) for _ in range(400))
            transport.send(b"answer")
            assert a.recv(9) == c.recv(9) == b"answer"
        b.setblocking(False)
        with pytest.raises(BlockingIOError):
            b.recv(9)
