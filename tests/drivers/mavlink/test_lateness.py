"""When a link has so much to do that some of what has come is left out."""

import pytest

import drivers.mavlink.link
from drivers.endpoint import parse_endpoint
from drivers.mavlink.backlog import PATIENCE_S, STALL_S
from drivers.mavlink.link import LONGEST_REST_S, MavlinkLink
from drivers.mavlink.transports.datagrams import Datagrams
from tests.drivers.mavlink.test_backlog import arrived


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
