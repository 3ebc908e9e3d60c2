"""Packets that pass without being judged say what they would say if Python judged each."""

import random

import numpy as np
import pytest

import drivers.mavlink.link
from drivers.endpoint import parse_endpoint
from drivers.events import Imu, Malformed, Notice, RefusedFrames, VehicleId
from drivers.mavlink.encoder import FrameEncoder, heartbeat, raw_imu
from drivers.mavlink.leases import JUDGED, LONGEST_US, PASSES, WAITS, Leases
from drivers.mavlink.link import MavlinkLink
from drivers.mavlink.readings import events_of
from drivers.mavlink.scanning import Scanner
from drivers.mavlink.transports.datagrams import Datagrams, peer_number
from drivers.mavlink.transports.transport import Packet
from estimator.reasons import Reason
from tests.drivers.mavlink.test_usual_frames import is_compiled

START_US = 1_700_000_000_000_000
STILL = ((0.01, 0.02, 0.03), (0.1, 0.2, -9.8), (0.2, 0.0, 0.4))


class Kept:
    """In the place of a recorder."""

    def __init__(self) -> None:
        self.data, self.frames, self.missed = b"", 0, 0

    def write(self, records):
        self.data += records.data
        self.frames += records.frames

    def miss(self, frames):
        self.missed += frames


class Link(MavlinkLink):
    """A link whose packets are handed in."""

    def __init__(self, *, judges_all: bool) -> None:
        super().__init__(parse_endpoint("udpin:127.0.0.1:1"))
        self.passed = 0
        self.recorded = self._background = Kept()
        if judges_all:
            self._lease = lambda *_: None

    def _is_late(self, *_):  # the time of a test is not the host's
        return False

    def take(self, packets, now_us):
        self._handle(Datagrams.of(packets, now_us), 1e-6 * now_us)
        passing = self._passing
        self.passed += 0 if passing is None else len(passing.frames)
        found = [*self._events]
        self._events.clear()
        while self._passing is not None:
            found += events_of(self._read_passing(self._passing))
        while self._backlog:
            found += events_of(self._decoder.readings_of(self._backlog.take()))
        return found


def stream(rng, steps):
    """Packets of three peers, who may speak for each other's vehicles, with damage of all kinds."""
    encoders = {system: FrameEncoder(VehicleId(system, 1)) for system in (1, 2, 3, 4)}
    home = {1: "a", 2: "b", 3: "b", 4: "c"}
    for step in range(steps):
        packets = []
        for _ in range(rng.randrange(1, 9)):
            now_us = START_US + 20_010 * step + rng.randrange(20_000)
            system = rng.choice((1, 2, 3, 4))
            time_us = 20_000 * step + 40 * len(packets)
            frames = [encoders[system].frame(raw_imu(time_us, *STILL), 0)]
            if rng.random() < 0.2:
                frames.append(encoders[system].frame(heartbeat(2, 3), 0))
            data, peer = b"".join(frames), home[system]
            kind = rng.random()
            if kind < 0.03:
                data = data[: rng.randrange(len(data))]
            elif kind < 0.06:
                data = rng.randbytes(20) + data
            elif kind < 0.09:
                peer = rng.choice("abc")
            elif kind < 0.1:
                data = b""
            elif kind < 0.12:
                data += encoders[1].frame(heartbeat(2, 3), 0)
            packets.append(Packet(peer, data, now_us))
        arrivals_us = enumerate(sorted(packet.arrival_us for packet in packets))
        in_order = [
            each._replace(arrival_us=us + k)
            for each, (k, us) in zip(packets, arrivals_us, strict=True)
        ]
        yield in_order, START_US + 20_010 * (step + 1)


def of_each(events):
    """Events by vehicle, in order; those of no vehicle as a set."""
    found = {}
    for event in events:
        found.setdefault(getattr(event, "vehicle", None), []).append(repr(event))
    return {who: said if who is not None else sorted(said) for who, said in found.items()}


@is_compiled
@pytest.mark.parametrize("seed", range(4))
def test_what_passes_says_what_a_judge_would_let_in(seed, monkeypatch):
    """For 15 s, so that sequences are looked at a second time. Either puts the same on record."""
    passing, judging = (Link(judges_all=judges) for judges in (False, True))
    kinds = set()
    for packets, now_us in stream(random.Random(seed), 750):
        monkeypatch.setattr(drivers.mavlink.link, "unix_us", lambda now_us=now_us: now_us)
        ours, theirs = (link.take(packets, now_us) for link in (passing, judging))
        assert of_each(ours) == of_each(theirs)
        kinds |= {type(event) for event in ours}
    assert {Imu, Malformed, RefusedFrames} <= kinds
    assert judging.passed == 0
    assert passing.passed > 1000
    assert passing.recorded.data == judging.recorded.data
    assert passing.recorded.frames == judging.recorded.frames > 2000


@is_compiled
def test_who_passes_keeps_the_address_and_is_still_counted(monkeypatch):
    """From 2 to 4 s all passes; then another peer speaks, and from 19.8 s on two on one wire."""
    link, encoders = Link(judges_all=False), [FrameEncoder(VehicleId(1, 1)) for _ in range(2)]
    said = []
    for step in range(1120):
        now_us = START_US + 20_000 * step
        monkeypatch.setattr(drivers.mavlink.link, "unix_us", lambda now_us=now_us: now_us)
        encoder = encoders[step % 2 if step > 990 else 0]
        packets = [Packet("a", encoder.frame(raw_imu(20_000 * step, *STILL), 0), now_us)]
        if step == 200:
            passed = link.passed
            packets.append(Packet("b", encoders[1].frame(raw_imu(1, *STILL), 0), now_us + 1))
        found = link.take(packets, now_us)
        if step == 200:
            assert passed > 95
            assert [each.reason for each in found if isinstance(each, RefusedFrames)] == [
                Reason.ADDRESS_CONFLICT
            ]
        said += [each.text for each in found if isinstance(each, Notice)]
    assert [text for text in said if "two senders" in text]


@is_compiled
def test_a_lease_is_for_one_peer_and_address_and_ends():
    leases, encoder = Leases(), FrameEncoder(VehicleId(7, 2))
    frame = encoder.frame(raw_imu(1, *STILL), 0)
    nobody, everybody = [False] * (1 << 16), [True] * (1 << 16)

    def passes(peer, data, arrival_us, waiting=()):
        come = Datagrams.of([Packet(peer, data, arrival_us)], arrival_us)
        scanned = Scanner(frozenset({27})).scan(come)
        done, passing = leases.passing(scanned, waiting, np.array(everybody))
        assert len(passing) == int(done[0] == PASSES)
        return bool(done[0] == PASSES)

    address = 7 << 8 | 2
    assert not passes("a", frame, START_US)
    leases.grant(address, peer_number("a"), "a", START_US, 1_000_000)
    assert passes("a", frame, START_US)
    assert not passes("b", frame, START_US)
    assert not passes("a", frame[:-1], START_US)
    assert not passes("a", frame, START_US, waiting=[address])
    assert not passes("a", frame, START_US + 1_000_000)  # it has ended
    assert not passes("a", frame, START_US - LONGEST_US)  # the clock was set back
    assert leases.heard_us(address, "a") == START_US
    assert leases.heard_us(address, "b") == 0
    leases.grant(address, peer_number("a"), "a", START_US, 10)
    packets = [Packet("a", frame, START_US + late_us) for late_us in (11, 4)]
    scanned = Scanner(frozenset({27})).scan(Datagrams.of(packets, START_US))
    done, _ = leases.passing(scanned, (), np.array(everybody))
    assert done.tolist() == [JUDGED, WAITS]  # what comes behind one that waits does, too
    scanned = Scanner(frozenset({27})).scan(Datagrams.of(packets[1:], START_US))
    done, _ = leases.passing(scanned, (), np.array(nobody))
    assert done.tolist() == [WAITS]  # a newcomer
    leases.end(peer_number("b"))
    assert passes("a", frame, START_US)
    leases.end(peer_number("a"))
    assert not passes("a", frame, START_US)


@is_compiled
def test_of_many_that_one_peer_brings_some_are_judged_now_and_then():
    leases, longest_us = Leases(), 4_000_000
    packets = []
    for number in range(1000):
        who = VehicleId(1 + number % 250, 1 + number // 250)
        leases.grant(who.system_id << 8 | who.component_id, peer_number("a"), "a", 0, longest_us)
        packets.append(FrameEncoder(who).frame(raw_imu(1, *STILL), 0))
    judged = []
    for now_us in range(1_000_000, 4_500_000, 20_000):
        come = Datagrams.of([Packet("a", each, now_us) for each in packets], now_us)
        scanned = Scanner(frozenset({27})).scan(come)
        done, _ = leases.passing(scanned, (), np.ones(1 << 16, bool))
        judged.append(int((done == JUDGED).sum()))
    assert judged[:50] == [0] * 50  # for half of the longest all pass
    assert judged[-1] == 1000
    assert max(np.diff(judged)) <= 16  # more at a look; 10 where all were spread evenly


@is_compiled
def test_what_is_left_out_is_on_record_or_counted_as_missing(monkeypatch):
    """Of a newcomer's datagrams the newest goes on record, of who has a lease all do."""
    link, encoder = Link(judges_all=False), FrameEncoder(VehicleId(1, 1))
    link._is_late = lambda *_: True
    for look, (frames, missed) in enumerate([(1, 4), (6, 4)]):
        now_us = START_US + 100_000 * (look + 1)
        monkeypatch.setattr(drivers.mavlink.link, "unix_us", lambda now_us=now_us: now_us)
        packets = [
            Packet("a", encoder.frame(raw_imu(1000 * (5 * look + k), *STILL), 0), now_us - 10 + k)
            for k in range(5)
        ]
        link.take(packets, now_us)
        assert (link.recorded.frames, link.recorded.missed) == (frames, missed)
