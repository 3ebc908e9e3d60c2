"""Many datagrams read at one go are those that are read one by one."""

import socket
import time

import pytest

from drivers.mavlink.transports.datagrams import Datagrams
from drivers.mavlink.transports.receive_many import (
    AT_ONCE,
    ManyReader,
    can_read_many,
    ipv4_name,
    ipv4_number,
    ipv4_sender,
)
from drivers.mavlink.transports.sockets import new_socket
from drivers.mavlink.transports.transport import Packet
from drivers.mavlink.transports.udp import SO_TIMESTAMPNS

NOW_US = 1_700_000_000_000_000


@pytest.fixture
def sockets():
    """One that is read, and two that send to it."""
    with new_socket(socket.AF_INET, socket.SOCK_DGRAM) as read:
        read.bind(("127.0.0.1", 0))
        if not can_read_many(read):
            pytest.skip("not Linux, or nothing is compiled")
        senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        for each in senders:
            each.connect(read.getsockname())
        yield read, senders
        for each in senders:
            each.close()


def packets_of(come):
    return [come.packet(k) for k in range(come.number)]


@pytest.mark.parametrize("stamped", [True, False])
def test_what_is_read_is_what_was_sent(sockets, stamped):
    """But for empty ones; the largest, too, and more than a call takes, in the order of sending."""
    read, senders = sockets
    if stamped:
        read.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    reader = ManyReader(read)
    assert packets_of(reader.read(1000, lambda: NOW_US)[0]) == []
    sizes = [0, 65_507, 1, *[50 + k % 90 for k in range(3 * AT_ONCE)]]
    sent = [
        (k % 2, bytes([k % 256]) * size) for k, size in enumerate(sizes * 2)
    ]  # what was learnt in the first half stays out of the second
    for turn in range(2):
        half = sent[turn * len(sizes) : (turn + 1) * len(sizes)]
        before_us = time.time_ns() // 1000
        for who, data in half:
            senders[who].send(data)
        come, number = reader.read(16_384, lambda: NOW_US)
        after_us = time.time_ns() // 1000
        assert number == 0
        names = ["{}:{}".format(*each.getsockname()) for each in senders]
        found = packets_of(come)
        assert [(each.peer, each.data) for each in found] == [(names[w], d) for w, d in half if d]
        if stamped:
            assert all(before_us <= each.arrival_us <= after_us for each in found)
        else:
            assert {each.arrival_us for each in found} == {NOW_US}


def test_a_reader_stops_where_it_should_and_goes_on_from_there(sockets):
    read, (sender, _) = sockets
    for k in range(3 * AT_ONCE):
        sender.send(bytes([k % 256]))
    reader, found = ManyReader(read), []
    for _ in range(3):
        come, _ = reader.read(1, lambda: NOW_US)
        assert come.number == AT_ONCE
        found += [each.data[0] for each in packets_of(come)]
    assert found == [k % 256 for k in range(3 * AT_ONCE)]


def test_a_sender_is_named_by_its_number():
    for host, port in (("127.0.0.1", 14550), ("255.254.0.1", 65_535), ("0.0.0.0", 0)):
        number = ipv4_number(host, port)
        assert ipv4_sender(number) == (host, port)
        assert ipv4_name(number) == f"{host}:{port}"


def test_packets_as_one_piece_of_memory():
    packets = [Packet("a", b"one", 5), Packet("b", b""), Packet("a", b"three", 7)]
    come = Datagrams.of(packets, NOW_US)
    assert packets_of(come) == [packets[0], Packet("b", b"", NOW_US), packets[2]]
    assert packets_of(come.kept(come.peers == come.peers[0])) == [packets[0], packets[2]]
