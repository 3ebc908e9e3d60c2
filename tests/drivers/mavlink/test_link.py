"""The link over real sockets and a pseudo terminal, with pymavlink on the other side."""

import contextlib
import errno
import logging
import os
import socket
import threading
import time
from pathlib import Path

import pytest

from drivers.endpoint import Endpoint, parse_endpoint
from drivers.events import CommandAck, Heartbeat, Imu, LinkDown, LinkUp, Malformed, Shed, VehicleId
from drivers.mavlink import connection
from drivers.mavlink import link as mavlink_link
from drivers.mavlink.constants import mavlink
from drivers.mavlink.encoder import FrameEncoder, heartbeat, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import Policy
from drivers.mavlink.link import MavlinkLink
from drivers.mavlink.recorder import Recorder
from drivers.mavlink.signing import SigningCheck
from drivers.mavlink.transports.tcp import MOST_TCP_CLIENTS
from drivers.mavlink.transports.transport import Packet
from drivers.mavlink.transports.udp import UdpIn
from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions
from estimator.errors import InputError
from tests.drivers.mavlink.pymavlink_parser import PymavlinkParser

HOST = "127.0.0.1"
PATIENCE_S = 20.0  # a slow machine fails no test
LEVEL = ((0.0, 0.0, -9.80665), (0.0, 0.0, 0.0), (0.2, 0.0, 0.4))


class Vehicle:
    """Frames of one vehicle, 10 ms apart."""

    def __init__(self, system_id=1):
        self._frames = FrameEncoder(VehicleId(system_id, 1))
        self._time_us = 1_000_000

    def imu(self):
        self._time_us += 10_000
        return self._frames.frame(raw_imu(self._time_us, *LEVEL), 0)

    def heartbeat(self):
        return self._frames.frame(heartbeat(2, 3), 0)


def port_of(link):
    return int(link.address.rpartition(":")[2])


def free_port(kind):
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def collect(link, enough, provoke=lambda: None):
    """Events until ``enough(events)``, calling ``provoke`` at every turn."""
    events, deadline = [], time.monotonic() + PATIENCE_S
    while not enough(events):
        assert time.monotonic() < deadline, f"gave up with {events[-5:]}"
        provoke()
        events += link.drain(0.02)
    return events


def accept(server, link, events):
    """The link's connection, which it makes while it is drained into ``events``."""
    server.settimeout(0.01)
    for _ in range(int(PATIENCE_S / 0.02)):
        with contextlib.suppress(TimeoutError):
            accepted = server.accept()[0]
            accepted.settimeout(PATIENCE_S)
            return accepted
        events += link.drain(0.0)
    raise AssertionError("no connection was made")


def count(kind, n=1):
    return lambda events: sum(isinstance(event, kind) for event in events) >= n


def of_type(events, kind):
    return [event for event in events if isinstance(event, kind)]


@contextlib.contextmanager
def udp_sender(port):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect((HOST, port))
        sender.settimeout(PATIENCE_S)
        yield sender


@contextlib.contextmanager
def udp_link(recorder=None, **options):
    """A link that listens, and who sends to it."""
    port = free_port(socket.SOCK_DGRAM)
    link = MavlinkLink(Endpoint("udpin", HOST, port), recorder, **options)
    with udp_sender(port) as sender, link:
        yield link, sender


@contextlib.contextmanager
def tcp_link(host=HOST, **options):
    """A link that accepts, and what connects to it, from an address of its own if one is given."""
    port = free_port(socket.SOCK_STREAM)
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(MavlinkLink(Endpoint("tcpin", host, port), **options))

        def connect(source=None):
            source = source and (source, 0)
            client = socket.create_connection((HOST, port), PATIENCE_S, source)
            stack.enter_context(client)
            connect.events += link.drain(0.0)
            return client

        connect.events = []
        yield link, connect


@pytest.fixture(autouse=True)
def nothing_leaks():
    """Every test ends with the threads and file descriptors it began with."""
    mavlink()  # the dialect is loaded once
    descriptors = open_descriptors()
    threads = threading.active_count()
    yield
    # a thread's work is done a moment before the thread is
    end_s = time.monotonic() + PATIENCE_S
    while threading.active_count() > threads and time.monotonic() < end_s:
        time.sleep(0.01)
    assert threading.active_count() == threads
    assert open_descriptors() == descriptors


def open_descriptors():
    folder = Path("/proc/self/fd")
    return len(list(folder.iterdir())) if folder.is_dir() else 0


def test_udpin_takes_several_senders_and_answers_all():
    with udp_link(request_rate_hz=50.0) as (link, a), udp_sender(port_of(link)) as b:
        for sender, vehicle in ((a, Vehicle(1)), (b, Vehicle(2))):
            sender.send(vehicle.heartbeat())
            frame = vehicle.imu()
            sender.send(frame[:10])  # one parser a sender: halves of frames do not mix
            sender.send(frame[10:])
        events = collect(link, count(Imu, 2))
        assert isinstance(events[0], LinkUp)
        assert {e.vehicle for e in of_type(events, Imu)} == {VehicleId(1, 1), VehicleId(2, 1)}
        now_us = time.time_ns() // 1000
        assert all(abs(e.arrival_us - now_us) < PATIENCE_S * 1e6 for e in events)
        link.drain(0)
        assert a.recv(100) == b.recv(100)  # it asks for the rate
        assert link.dropped == 0


def test_a_listening_link_sends_nothing():
    with udp_link() as (link, sender):
        vehicle = Vehicle()
        collect(link, count(Imu, 150), lambda: sender.send(vehicle.heartbeat() + vehicle.imu()))
        sender.setblocking(False)
        with pytest.raises(BlockingIOError):
            sender.recv(100)


def test_udpout_announces_itself_as_an_onboard_computer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((HOST, 0))
        other.settimeout(PATIENCE_S)
        with MavlinkLink(Endpoint("udpout", HOST, other.getsockname()[1])) as link:
            link.drain(0)
            data, address = other.recvfrom(1000)
            (hello,) = PymavlinkParser().feed(data)
            assert (hello.get_type(), hello.get_srcComponent()) == ("HEARTBEAT", 191)
            assert (hello.type, hello.autopilot) == (18, 8)
            other.sendto(Vehicle().imu(), address)
            collect(link, count(Imu))


def test_a_refused_tcp_connection_is_retried(caplog):
    port = free_port(socket.SOCK_STREAM)
    with caplog.at_level(logging.WARNING), MavlinkLink(Endpoint("tcp", HOST, port)) as link:
        (down,) = collect(link, count(LinkDown))
        assert "refused" in down.reason
        for _ in range(80):  # several attempts later
            link.drain(0.01)
        assert len(caplog.records) == 1  # one line
        with socket.create_server((HOST, port)) as server:
            events = []
            accepted = accept(server, link, events)
            with accepted:
                vehicle = Vehicle()
                events += collect(link, count(Imu, 3), lambda: accepted.sendall(vehicle.imu()))
        assert isinstance(events[0], LinkUp)
        assert of_type(events, LinkDown) == []


def test_a_lost_tcp_connection_is_made_again():
    with socket.create_server((HOST, 0)) as server:
        vehicle = Vehicle()
        with MavlinkLink(Endpoint("tcp", HOST, server.getsockname()[1])) as link:
            for _ in range(2):
                accepted = accept(server, link, [])
                with accepted:
                    accepted.sendall(vehicle.imu() + vehicle.imu()[:7])  # ends in half a frame
                    collect(link, count(Imu))
                (down,) = of_type(collect(link, count(LinkDown)), LinkDown)
                assert "closed by the other side" in down.reason
            accepted = accept(server, link, [])
            with accepted:
                accepted.sendall(vehicle.imu())
                events = collect(link, count(Imu))
            assert of_type(events, Malformed) == []


def test_a_server_that_hangs_up_at_once_does_not_fill_the_log(caplog):
    with socket.create_server((HOST, 0)) as server, caplog.at_level(logging.INFO):
        with MavlinkLink(Endpoint("tcp", HOST, server.getsockname()[1])) as link:
            events = []
            for _ in range(4):
                accept(server, link, events).close()
            if not of_type(events, LinkDown):
                collect(link, count(LinkDown))
        assert len(caplog.records) == 1


def test_tcpin_accepts_several_clients():
    with tcp_link(request_rate_hz=50.0) as (link, connect):
        with connect() as a, connect() as b:
            one = Vehicle(1)
            a.sendall(one.heartbeat() + one.imu())
            b.sendall(Vehicle(2).imu())
            events = connect.events + collect(link, count(Imu, 2))
            assert len(of_type(events, LinkUp)) == 1
            link.drain(0)
            assert a.recv(100) == b.recv(100)  # it asks for the rate
        (down,) = of_type(collect(link, count(LinkDown)), LinkDown)
        assert "client" in down.reason
        connect.events.clear()
        connect().sendall(Vehicle(3).imu())
        assert count(LinkUp)(connect.events + collect(link, count(Imu)))


@pytest.mark.parametrize("noise", [b"", b"\0"], ids=["silent", "babbling"])
def test_idle_clients_give_way_to_a_vehicle_and_it_does_not_to_them(noise, caplog):
    """Those go first, whoever is the latest; that is logged once a minute at most."""
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

        def systems(events):
            return {each.vehicle.system_id for each in events if isinstance(each, Imu | Heartbeat)}

        collect(link, lambda events: len(systems(events)) == MOST_TCP_CLIENTS, send)
        clients[late := connect(f"127.0.0.{host}")] = flying
        if is_let_in:
            collect(
                link,
                lambda events: sum(e.vehicle.system_id == 1 for e in of_type(events, Imu)) > 9,
                send,
            )
        else:
            link.drain(0.1)
            assert late.recv(1) == b""
            collect(link, lambda events: len(systems(events)) == MOST_TCP_CLIENTS, send)


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
    port, vehicle, other = free_port(socket.SOCK_DGRAM), Vehicle(1), Vehicle(2)
    with (
        MavlinkLink(Endpoint("udpin", HOST, port)) as link,
        udp_sender(port) as flying,
        udp_sender(port) as flood,
    ):

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

        def ours(found):
            return [e for e in of_type(events + found, Imu) if e.vehicle.system_id == 1]

        taken = lambda found: len(ours(found)) + link.shed + link.lost  # noqa: E731
        # on a busy computer more is let in, by time
        rate_hz = connection.IMU_PACKETS_HZ if has_imu else connection.PACKETS_HZ
        each = min(1 + len(content) // connection.FRAME_BYTES, rate_hz)
        let_in = 2 + rate_hz * (1.0 + time.monotonic() - begun_s) / each
        refused = lambda: not content or link.dropped - before + link.lost >= 200 - let_in  # noqa: E731
        events += collect(link, lambda found: taken(found) >= 36 and refused())
        assert len(ours([])) > 8


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


@pytest.mark.parametrize("method", ["receive", "open"])
def test_without_file_descriptors_the_link_is_tried_again(monkeypatch, method):
    """The reader needs one at each look, and to open: that is a broken link as any other."""
    vehicle = Vehicle(1)
    with udp_link() as (link, sender):

        def send():
            with contextlib.suppress(ConnectionRefusedError):  # it is not open again yet
                sender.send(vehicle.imu())

        def fail(*_):
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

        collect(link, count(Imu), send)
        with monkeypatch.context() as patch:
            patch.setattr(UdpIn, "receive", fail)
            if method == "open":
                patch.setattr(UdpIn, "open", fail)
            lost = collect(link, count(LinkDown))
            time.sleep(0.3)
        assert "Too many open files" in of_type(lost, LinkDown)[0].reason
        collect(link, count(Imu), send)


@pytest.mark.skipif(os.name != "posix", reason="needs pseudo terminals")
def test_a_serial_line_comes_and_goes(tmp_path):
    import pty

    device = tmp_path / "ttyV0"
    vehicle = Vehicle()

    def plug_in():
        master, slave = pty.openpty()
        device.unlink(missing_ok=True)
        device.symlink_to(os.ttyname(slave))
        return master, slave

    master, slave = plug_in()
    with MavlinkLink(parse_endpoint(f"{device}:57600"), request_rate_hz=50.0) as link:
        os.write(master, vehicle.heartbeat() + vehicle.imu())
        events = collect(link, count(Imu))
        assert isinstance(events[0], LinkUp)
        link.drain(0)
        assert os.read(master, 100)[:1] == b"\xfd"  # it asks for the rate
        os.close(slave)
        os.close(master)
        collect(link, count(LinkDown))
        master, slave = plug_in()
        collect(link, count(LinkUp))
        os.write(master, vehicle.imu())
        collect(link, count(Imu))
    os.close(slave)
    os.close(master)


@pytest.mark.skipif(os.name != "posix", reason="needs pseudo terminals")
def test_a_serial_line_in_use_is_refused():
    import pty

    master, slave = pty.openpty()
    endpoint = Endpoint("serial", path=os.ttyname(slave), baud=57600)
    with MavlinkLink(endpoint), pytest.raises(InputError, match="in use"), MavlinkLink(endpoint):
        pass
    os.close(slave)
    os.close(master)


@pytest.mark.parametrize(
    ("endpoint", "reason"),
    [
        (Endpoint("serial", path="/dev/no_such_device", baud=57600), "No such file"),
        (Endpoint("serial", path=os.devnull, baud=57600), os.devnull),
        (Endpoint("udpout", "no-such-host.invalid", 14550), "no-such-host.invalid"),
        (Endpoint("tcp", "no-such-host.invalid", 5760), "no-such-host.invalid"),
        (Endpoint("udpin", "192.0.2.1", 14550), "udpin:192.0.2.1:14550"),  # not an address of ours
        (Endpoint("log", path="flight.tlog"), "no MAVLink link"),
    ],
)
def test_what_cannot_work_is_refused_at_the_start(endpoint, reason):
    with pytest.raises(InputError, match=reason), MavlinkLink(endpoint):
        pass


@pytest.mark.parametrize(("kind", "name"), [(socket.SOCK_DGRAM, "udpin"),
                                            (socket.SOCK_STREAM, "tcpin")])  # fmt: skip
def test_a_taken_port_is_refused(kind, name):
    with socket.socket(socket.AF_INET, kind) as owner:
        owner.bind((HOST, 0))
        if kind == socket.SOCK_STREAM:
            owner.listen()
        port = owner.getsockname()[1]
        with pytest.raises(InputError, match=f"{name}:{HOST}:{port}.*in use"), \
                MavlinkLink(Endpoint(name, HOST, port)):  # fmt: skip
            pass


def test_only_a_full_queue_leaves_samples_out_and_the_newest_stay(tmp_path):
    """Each is taken or counted, what is sent once stays, and all are in the recording."""
    path, one, two = tmp_path / "flight.tlog", Vehicle(1), Vehicle(2)
    with Recorder(path) as recorder, udp_link(recorder, most_waiting=100) as (link, sender):
        sent = b""
        for number in range(150):
            frames = [one.imu(), two.imu(), *([two.heartbeat()] if number == 9 else [])]
            for frame in frames:
                sender.send(frame)
                sent += frame
        newest = one._time_us
        events = collect(
            link,
            lambda found: (
                count(Heartbeat)(found) and newest in [e.boot_us for e in of_type(found, Imu)]
            ),
        )
        time.sleep(0.3)
        events += link.drain(0.0)
        shed = link.shed
    taken = len(of_type(events, Imu))
    assert shed > 100
    assert abs(taken + shed - 300) <= 2  # a first sample waits for its second
    assert sum(each.samples for each in of_type(events, Shed)) == shed
    assert len(path.read_bytes()) == len(sent) + 8 * 301
    assert recorder.is_whole


def test_garbage_is_counted_and_survived():
    vehicle = Vehicle()
    with udp_link() as (link, sender):
        sender.send(b"GET / HTTP/1.1\r\n\r\n" + bytes(range(256)))
        events = collect(link, count(Imu, 20), lambda: sender.send(vehicle.imu()))
    assert sum(e.frames for e in of_type(events, Malformed)) >= 1


def test_the_recording_holds_the_frames_as_they_came(tmp_path):
    vehicle, path = Vehicle(), tmp_path / "flight.tlog"
    frames = [vehicle.heartbeat(), *(vehicle.imu() for _ in range(20))]
    with Recorder(path) as recorder, udp_link(recorder) as (link, sender):
        sender.send(b"noise")
        for frame in frames:
            sender.send(frame)
        events = collect(link, count(Imu, 20))
    data, stamps = path.read_bytes(), []
    for frame in frames:
        stamps.append(int.from_bytes(data[:8], "big"))
        assert data[8 : 8 + len(frame)] == frame
        data = data[8 + len(frame) :]
    assert data == b""
    assert stamps[1:] == [e.arrival_us for e in of_type(events, Imu)]


def test_a_recording_begins_with_the_port_s_opening_and_not_with_the_first_look(tmp_path):
    """More comes than the system keeps for a socket, before anybody drains."""
    path, sent, vehicle, stamp = tmp_path / "flight.tlog", b"", Vehicle(), 8
    with Recorder(path) as recorder, udp_link(recorder) as (link, sender):
        for number in range(12_000):
            frame = vehicle.imu()
            sender.send(frame)
            sent += bytes(stamp) + frame
            if number % 500 == 0:
                time.sleep(0.05)
        link.drain(0.0)
        lost = link.lost
    assert lost == 0
    assert path.stat().st_size == len(sent)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_does_not_stop_the_link():
    vehicle = Vehicle()
    with Recorder("/dev/full") as recorder, udp_link(recorder) as (link, sender):
        collect(link, count(Imu, 20), lambda: sender.send(vehicle.imu()))
    assert recorder.lost >= 20


def test_a_requested_rate_is_acknowledged_and_delivered():
    """The simulated autopilot answers on the same socket that it sends from."""
    autopilot, parser = SimulatedAutopilot(VehicleOptions(rate_hz=2.0), 5), PymavlinkParser()
    boot_us, asked = 0, []
    with udp_link(request_rate_hz=100.0) as (link, sender):

        def play():
            nonlocal boot_us
            boot_us += 50_000
            sender.send(autopilot.advance(boot_us, 0) or b"\0")
            sender.settimeout(0.001)
            with contextlib.suppress(TimeoutError):
                while True:
                    for message in parser.feed(sender.recv(1000)):
                        asked.append(message)
                        if answer := autopilot.handle(message, 0):
                            sender.send(answer)

        events = collect(link, count(CommandAck), play)
        assert of_type(events, CommandAck)[0].result == 0
        events = collect(link, count(Imu, 500), play)
    boots = [e.boot_us for e in of_type(events, Imu)][-400:]
    assert (boots[-1] - boots[0]) / 399 == pytest.approx(10_000)
    assert {m.get_type() for m in asked} == {"HEARTBEAT", "COMMAND_LONG"}
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in asked} == {(5, 191)}
    assert all(m.type == 18 for m in asked if m.get_type() == "HEARTBEAT")


def test_a_mistake_of_ours_reaches_the_consumer(monkeypatch):
    monkeypatch.setattr(mavlink_link.MavlinkDecoder, "events", lambda *_: 1 / 0)
    with udp_link() as (link, sender), pytest.raises(ZeroDivisionError):
        collect(link, lambda _: False, lambda: sender.send(Vehicle().imu()))


def test_ipv6():
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind(("::1", 0))
            port = probe.getsockname()[1]
    except OSError:
        pytest.skip("no IPv6 on this machine")
    with MavlinkLink(parse_endpoint(f"udpin:[::1]:{port}")) as link, \
            socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:  # fmt: skip
        sender.sendto(Vehicle().imu(), ("::1", port))
        collect(link, count(Imu))


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


def test_datagrams_that_were_lost_before_a_break_still_count(monkeypatch):
    monkeypatch.setattr(UdpIn, "lost", 3)

    def fail(*_):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with udp_link() as (link, _):
        collect(link, lambda _: link.lost == 3)
        with monkeypatch.context() as patch:
            patch.setattr(UdpIn, "receive", fail)
            collect(link, count(LinkDown))
        collect(link, lambda _: link.lost == 6)


def test_half_a_frame_of_a_client_that_has_left_costs_the_next_one_nothing(monkeypatch):
    beat = Vehicle(1).heartbeat()
    packets = [[Packet("a", data, 1)] for data in (beat[:9], b"", beat)]
    monkeypatch.setattr(UdpIn, "receive", lambda *_: packets.pop(0) if packets else [])
    with udp_link() as (link, _):
        assert not of_type(collect(link, count(Heartbeat)), Malformed)


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
    transport = UdpIn(Endpoint("udpin", HOST, port))
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
