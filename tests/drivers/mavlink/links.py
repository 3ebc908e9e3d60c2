"""Links over real sockets, and who sends to them."""

import contextlib
import socket
import time

from drivers.endpoint import Endpoint
from drivers.events import VehicleId
from drivers.mavlink.encoder import FrameEncoder, heartbeat, raw_imu
from drivers.mavlink.link import MavlinkLink
from tests.fuzzbee.processes import free_port

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
