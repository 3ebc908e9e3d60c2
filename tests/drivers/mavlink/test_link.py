"""The link over real sockets and a pseudo terminal, with pymavlink on the other side."""

import contextlib
import errno
import logging
import os
import socket
import time

import pytest

from drivers.endpoint import Endpoint, parse_endpoint
from drivers.events import CommandAck, Heartbeat, Imu, LinkDown, LinkUp, Malformed, VehicleId
from drivers.mavlink import link as mavlink_link
from drivers.mavlink.link import MavlinkLink
from drivers.mavlink.transports.transport import Packet
from drivers.mavlink.transports.udp import Udp
from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions
from estimator.errors import InputError
from tests.drivers.mavlink.links import (
    HOST,
    PATIENCE_S,
    Vehicle,
    accept,
    collect,
    count,
    tcp_link,
    udp_link,
    udp_sender,
)
from tests.drivers.mavlink.messages import PymavlinkParser, only
from tests.fuzzbee.processes import free_port

pytestmark = pytest.mark.usefixtures("nothing_leaks")


def first_frame(receiver, system_id):
    return next(frame for frame in iter(lambda: receiver.recv(100), b"") if frame[5] == system_id)


def test_udpin_takes_several_senders_and_answers_all():
    with udp_link(request_rate_hz=50.0) as (link, a), udp_sender(a.getpeername()[1]) as b:
        for sender, vehicle in ((a, Vehicle(1)), (b, Vehicle(2))):
            sender.send(vehicle.heartbeat())
            frame = vehicle.imu()
            sender.send(frame[:10])  # one parser a sender: halves of frames do not mix
            sender.send(frame[10:])
        events = collect(link, count(Imu, 2))
        assert isinstance(events[0], LinkUp)
        assert {e.vehicle for e in only(Imu, events)} == {VehicleId(1, 1), VehicleId(2, 1)}
        now_us = time.time_ns() // 1000
        assert all(abs(e.arrival_us - now_us) < PATIENCE_S * 1e6 for e in events)
        link.drain(0)
        # It asks for the rate. The first vehicle may have been asked before b was known.
        assert first_frame(a, system_id=2) == first_frame(b, system_id=2)
        assert link.dropped == 0


def test_a_listening_link_sends_nothing():
    with udp_link() as (link, sender):
        vehicle = Vehicle()
        collect(link, count(Imu, 150), lambda: sender.send(vehicle.heartbeat() + vehicle.imu()))
        sender.setblocking(False)
        with pytest.raises(BlockingIOError):
            sender.recv(100)


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
            with accept(server, link, events) as accepted:
                vehicle = Vehicle()
                events += collect(link, count(Imu, 3), lambda: accepted.sendall(vehicle.imu()))
        assert isinstance(events[0], LinkUp)
        assert only(LinkDown, events) == []


def test_a_lost_tcp_connection_is_made_again():
    with socket.create_server((HOST, 0)) as server:
        vehicle = Vehicle()
        with MavlinkLink(Endpoint("tcp", HOST, server.getsockname()[1])) as link:
            for _ in range(2):
                with accept(server, link, []) as accepted:
                    accepted.sendall(vehicle.imu() + vehicle.imu()[:7])  # ends in half a frame
                    collect(link, count(Imu))
                (down,) = only(LinkDown, collect(link, count(LinkDown)))
                assert "closed by the other side" in down.reason
            with accept(server, link, []) as accepted:
                accepted.sendall(vehicle.imu())
                events = collect(link, count(Imu))
            assert only(Malformed, events) == []


def test_a_server_that_hangs_up_at_once_does_not_fill_the_log(caplog):
    with socket.create_server((HOST, 0)) as server, caplog.at_level(logging.INFO):
        with MavlinkLink(Endpoint("tcp", HOST, server.getsockname()[1])) as link:
            events = []
            for _ in range(4):
                accept(server, link, events).close()
            if not only(LinkDown, events):
                collect(link, count(LinkDown))
        assert len(caplog.records) == 1


def test_tcpin_accepts_several_clients():
    with tcp_link(request_rate_hz=50.0) as (link, connect):
        with connect() as a, connect() as b:
            one = Vehicle(1)
            a.sendall(one.heartbeat() + one.imu())
            b.sendall(Vehicle(2).imu())
            events = connect.events + collect(link, count(Imu, 2))
            assert len(only(LinkUp, events)) == 1
            link.drain(0)
            assert a.recv(100) == b.recv(100)  # it asks for the rate
        (down,) = only(LinkDown, collect(link, count(LinkDown)))
        assert "client" in down.reason
        connect.events.clear()
        connect().sendall(Vehicle(3).imu())
        assert count(LinkUp)(connect.events + collect(link, count(Imu)))


def without_descriptors(*_):
    raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))


@pytest.mark.parametrize("method", ["receive", "open"])
def test_without_file_descriptors_the_link_is_tried_again(monkeypatch, method):
    """The reader needs one at each look, and to open: that is a broken link as any other."""
    vehicle = Vehicle(1)
    with udp_link() as (link, sender):

        def send():
            with contextlib.suppress(ConnectionRefusedError):  # it is not open again yet
                sender.send(vehicle.imu())

        collect(link, count(Imu), send)
        with monkeypatch.context() as patch:
            patch.setattr(Udp, "receive", without_descriptors)
            if method == "open":
                patch.setattr(Udp, "open", without_descriptors)
            lost = collect(link, count(LinkDown))
            time.sleep(0.3)
        assert "Too many open files" in only(LinkDown, lost)[0].reason
        collect(link, count(Imu), send)


@contextlib.contextmanager
def terminal():
    """A pseudo terminal: the end that we write to, and the other one's name."""
    pty = pytest.importorskip("pty", reason="needs pseudo terminals")
    ends = pty.openpty()
    try:
        yield ends[0], os.ttyname(ends[1])
    finally:
        for end in ends:
            os.close(end)


def test_a_serial_line_comes_and_goes(tmp_path):
    device, vehicle = tmp_path / "ttyV0", Vehicle()
    with contextlib.ExitStack() as stack:
        with terminal() as (master, name):
            device.symlink_to(name)
            endpoint = parse_endpoint(f"{device}:57600")
            link = stack.enter_context(MavlinkLink(endpoint, request_rate_hz=50.0))
            os.write(master, vehicle.heartbeat() + vehicle.imu())
            events = collect(link, count(Imu))
            assert isinstance(events[0], LinkUp)
            link.drain(0)
            assert os.read(master, 100)[:1] == b"\xfd"  # it asks for the rate
        collect(link, count(LinkDown))
        device.unlink()
        with terminal() as (master, name):
            device.symlink_to(name)
            collect(link, count(LinkUp))
            os.write(master, vehicle.imu())
            collect(link, count(Imu))
            stack.close()


def test_a_serial_line_in_use_is_refused():
    with terminal() as (_, name):
        first, second = (MavlinkLink(Endpoint("serial", path=name, baud=57600)) for _ in range(2))
        with first, pytest.raises(InputError, match="in use"), second:
            pass


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

        assert only(CommandAck, collect(link, count(CommandAck), play))[0].result == 0
        events = collect(link, count(Imu, 500), play)
    boots = [e.boot_us for e in only(Imu, events)][-400:]
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


def test_datagrams_that_were_lost_before_a_break_still_count(monkeypatch):
    monkeypatch.setattr(Udp, "lost", 3)
    with udp_link() as (link, _):
        collect(link, lambda _: link.lost == 3)
        with monkeypatch.context() as patch:
            patch.setattr(Udp, "receive", without_descriptors)
            collect(link, count(LinkDown))
        collect(link, lambda _: link.lost == 6)


ONE, TWO, THREE = (Vehicle(system).heartbeat() for system in (1, 2, 3))
PACKETS = {  # a client leaves with an empty packet
    "of a client that has left": [("a", ONE[:9]), ("a", b""), ("a", ONE)],
    "of the sender silent for longest of too many": [
        ("a", ONE[:9]),
        ("b", TWO),
        ("a", ONE[9:] + ONE[:9]),
        ("c", THREE),
        ("a", ONE[9:]),
    ],
}


@pytest.mark.parametrize("packets", PACKETS.values(), ids=PACKETS)
def test_half_a_frame_is_forgotten_and_costs_no_other(packets, monkeypatch):
    monkeypatch.setattr("drivers.mavlink.link.MOST_READERS", 2)
    received = iter([[Packet(*packet, 1)] for packet in packets])
    monkeypatch.setattr(Udp, "receive", lambda *_: next(received, []))
    beats = 4 if len(packets) > 3 else 1
    with udp_link() as (link, _):
        assert not only(Malformed, collect(link, count(Heartbeat, beats)))
