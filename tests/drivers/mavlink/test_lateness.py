"""When a link has so much to do that some of what has come is left out."""

import pytest

import drivers.mavlink.link
from drivers.endpoint import parse_endpoint
from drivers.mavlink.backlog import PATIENCE_S, STALL_S
from drivers.mavlink.link import LONGEST_REST_S, MavlinkLink
from drivers.mavlink.transports.datagrams import Datagrams
from drivers.mavlink.transports.transport import Packet
from tests.drivers.mavlink.test_backlog import arrived

PERIOD_S = 0.0025  # of 400 Hz


class Busy:
    """A link, and a clock that runs while it looks and while others use what it has read."""

    stamps_arrivals = True

    def __init__(self, monkeypatch) -> None:
        self.clock_s = self.rest_s = 0.0
        monkeypatch.setattr(drivers.mavlink.link, "waiting_clock_s", lambda: self.clock_s)
        self.link = MavlinkLink(parse_endpoint("udpin:127.0.0.1:1"))
        self.link._transport = self

    def receive_many(self, _):
        self.clock_s += self.rest_s
        return Datagrams.of([], 0)

    def looks(self, busy_s, rest_s, for_s):
        """What a link says of looks that are so far apart: whether it is late."""
        self.rest_s, late, end_s = rest_s, [], self.clock_s + for_s
        while self.clock_s < end_s:
            self.clock_s += busy_s
            self.link._read(0.0)
            late.append(self.link._is_late(self.clock_s, self.clock_s))
        return late


@pytest.fixture
def busy(monkeypatch):
    return Busy(monkeypatch)


def test_who_rests_is_never_late(busy):
    assert not any(busy.looks(0.9 * PATIENCE_S, 3 * LONGEST_REST_S, 2.0))


def test_who_is_busy_for_longer_than_a_period_is_late_unless_for_a_moment(busy):
    busy.looks(0.1 * PATIENCE_S, 0.0, 0.1)
    late = busy.looks(1.1 * PATIENCE_S, 0.0, 2.0)
    first = late.index(True)
    assert 0.7 * STALL_S < first * 1.1 * PATIENCE_S <= STALL_S
    assert all(late[first:])


def test_newcomers_get_as_much_again(busy):
    busy.link._backlog.add([arrived(1, 0)], 0.0)
    assert not any(busy.looks(1.9 * PATIENCE_S, 0.0, 2.0))
    assert any(busy.looks(2.1 * PATIENCE_S, 0.0, 2.0))
    busy.link._backlog.take()
    assert any(busy.looks(1.9 * PATIENCE_S, 0.0, 2.0))


class Stream:
    """A transport on which a datagram comes each period, that far behind the period's begin."""

    stamps_arrivals = True

    def __init__(self, behind_s: float) -> None:
        self.now_s, self.next_s, self.wakes = 100.0, 100.0 + behind_s, 0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds
        self.wakes += 1

    def receive_many(self, timeout_s):
        if timeout_s > 0.0:
            self.sleep(min(timeout_s, max(0.0, self.next_s - self.now_s)))
        here = self.next_s <= self.now_s
        self.next_s += PERIOD_S * here
        return Datagrams.of([Packet("a", b"1", int(1e6 * self.now_s))] * here, 0)


@pytest.mark.parametrize("behind_s", [0.1 * PERIOD_S, 0.5 * PERIOD_S, 0.95 * PERIOD_S])
def test_who_reads_a_datagram_a_period_wakes_up_once_for_it(behind_s, monkeypatch):
    """Wherever in the period it comes, and also if that is a moment after the rest's end."""
    stream, link = Stream(behind_s), MavlinkLink(parse_endpoint("udpin:127.0.0.1:1"))
    monkeypatch.setattr(drivers.mavlink.link, "time", stream)
    link._transport = stream
    read = 0
    for period in range(1, 41):
        link._look_s = link._read_s = stream.now_s
        stream.now_s += 0.1 * PERIOD_S  # to handle it takes a while
        come = link._read(100.0 + period * PERIOD_S - stream.now_s)
        read += come.number
    assert read >= 38
    assert stream.wakes <= 44
