"""One vehicle by two ways, of which one is late, and two vehicles with one address."""

import random
from collections import Counter
from itertools import pairwise

import pytest

from drivers.events import ClockReset, Imu, Notice, RefusedFrames, VehicleId
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, heartbeat, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import EVERY_US, MOST_SENDERS, FrameGate, Policy
from tests.drivers.mavlink.messages import UNIX, VEHICLE, S, only

BOOT_US = 500 * S


def flight(seconds, boot_us=BOOT_US, seed=1):
    """What a vehicle sends: time in us, and bytes."""
    encoder, rng = FrameEncoder(VEHICLE), random.Random(seed)
    for number in range(int(seconds * 50)):
        at_us = 20_000 * number
        force = (rng.gauss(0.0, 0.1), rng.gauss(0.0, 0.1), -9.8)
        data = encoder.frame(raw_imu(boot_us + at_us, force, (0.0, 0.0, 0.1), (0.2, 0.0, 0.4)), 0)
        if number % 50 == 0:
            data += encoder.frame(heartbeat(2, 3), 0)
        yield at_us, data


class Wire:
    """A gate and a decoder behind it; what comes of packets in the order of their arrival."""

    def __init__(self, policy=Policy()):  # noqa: B008 - immutable
        self.gate, self.decoder, self.readers = FrameGate(policy), MavlinkDecoder(), {}

    def play(self, packets):
        events = []
        for at_us, peer, data in sorted(packets):
            reader = self.readers.setdefault(peer, FrameReader())
            for frame in self.gate.let_in(reader.feed(data), peer, UNIX + at_us):
                events += self.decoder.events(frame, UNIX + at_us)
            events += self.gate.take_refused(UNIX + at_us)
        return events


def lateness_s(events):
    """How far behind the vehicle each sample that was taken arrived."""
    return [(e.arrival_us - UNIX - (e.boot_us - BOOT_US)) / S for e in only(Imu, events)]


def refused(events):
    found = Counter()
    for event in only(RefusedFrames, events):
        found[event.reason] += event.frames
    return found


@pytest.mark.parametrize("late_s", [1, 5, 10])
@pytest.mark.parametrize("peers", ["ab", "aa"], ids=["two senders", "one wire"])
def test_a_late_copy_is_never_mixed_in_while_the_fresh_one_pauses(peers, late_s):
    sent = list(flight(60.0))
    fresh = [(at_us, peers[0], data) for at_us, data in sent if not 30 * S <= at_us < 31.5 * S]
    late = [(at_us + late_s * S, peers[1], data) for at_us, data in sent]
    events = Wire().play(fresh + late)
    assert not only(ClockReset, events)
    assert max(lateness_s(events)) < 0.1
    assert len(lateness_s(events)) == len(fresh)


@pytest.mark.parametrize("late_s", [1, 3, 5])
def test_the_fresher_copy_is_followed_when_it_comes_second(late_s):
    sent = list(flight(60.0))
    late = [(at_us + late_s * S, "late", data) for at_us, data in sent]
    fresh = [(at_us, "fresh", data) for at_us, data in sent if at_us >= 20 * S]
    events = Wire().play(fresh + late)
    behind_s = lateness_s(events)
    assert behind_s[0] == late_s
    # the first repeated frames are the proof, and nothing is missed while the other one takes over
    assert max(behind_s[int(50 * (22 + late_s)) :]) < 0.1
    arrivals_us = [e.arrival_us for e in only(Imu, events)]
    assert max(b - a for a, b in pairwise(arrivals_us)) < S // 2
    assert not only(ClockReset, events)


def test_a_late_copy_is_used_when_nothing_else_comes_for_long():
    sent = list(flight(60.0))
    fresh = [(at_us, "fresh", data) for at_us, data in sent if at_us < 20 * S]
    late = [(at_us + 3 * S, "late", data) for at_us, data in sent]
    behind_s = lateness_s(Wire().play(fresh + late))
    assert behind_s[-1] == 3
    assert len(behind_s) < len(sent) - 50 * 8


@pytest.mark.parametrize("ahead_s", [-5, 5])
def test_another_vehicle_of_the_same_address_is_no_copy_however_fresh(ahead_s):
    one = [(at_us, "a", data) for at_us, data in flight(20.0)]
    other = flight(20.0, BOOT_US + ahead_s * S, seed=2)
    events = Wire().play(one + [(at_us + 5, "b", data) for at_us, data in other])
    assert set(refused(events)) == {"address_conflict"}
    assert max(map(abs, lateness_s(events))) < 0.1


@pytest.mark.parametrize("peers", ["aa", "ab"], ids=["one port", "another port"])
@pytest.mark.parametrize("after_s", [3, 9])
def test_a_vehicle_that_starts_again_and_repeats_itself_is_no_copy(after_s, peers):
    """A simulated one may send the same readings with the same stamps after each start."""
    first = [(at_us, peers[0], data) for at_us, data in flight(after_s, boot_us=0)]
    pause_us = after_s * S + S // 2
    again = [(at_us + pause_us, peers[1], data) for at_us, data in flight(20.0, boot_us=0)]
    events = Wire().play(first + again)
    assert [e.reason for e in only(ClockReset, events)] == ["reboot"]
    assert set(refused(events)) <= {"address_conflict"}  # for a second after the first has gone
    assert len(only(Imu, events)) > len(first) + len(again) - 50


@pytest.mark.parametrize("peers", ["ab", "aa"], ids=["two senders", "one wire"])
@pytest.mark.parametrize("boot_us", [S, BOOT_US])
@pytest.mark.parametrize("late_s", [0.08, 0.2, 0.6])
def test_a_copy_that_is_a_little_late_is_no_clock_that_was_set_back(late_s, boot_us, peers):
    """Where the originals are missing for a moment, a row of copies comes."""
    sent = list(flight(20.0, boot_us))
    fresh = [(at_us, peers[0], d) for n, (at_us, d) in enumerate(sent) if n < 100 or n % 50 > 9]
    late = [(at_us + round(late_s * S), peers[1], d) for at_us, d in sent]
    events = Wire().play(fresh + late)
    assert not only(ClockReset, events)
    assert len(only(Imu, events)) >= len(fresh)


def test_what_this_program_has_sent_is_no_vehicle_s():
    """Until an IMU's data come from there: this program sends none."""
    own, wire = FrameEncoder(VehicleId(200, 1)), Wire(Policy(own=VehicleId(200, 1)))
    beat = own.frame(heartbeat(2, 0), 0)
    assert wire.play([(n, "a", beat) for n in range(5)]) == []
    (_, data), *_ = flight(1.0)
    assert wire.play([(9, "a", data)])
    sample = own.frame(raw_imu(S, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0), (0.2, 0.0, 0.4)), 0)
    assert len(wire.play([(10, "a", sample), (11, "a", beat)])) >= 1


@pytest.mark.parametrize("lost", [100, 255, 300])
def test_frames_that_are_missing_took_their_time_however_steadily_the_next_ones_come(lost):
    """A fresher copy takes over; the numbers do not show 255 that are missing."""
    encoder, gyr, mag = FrameEncoder(VEHICLE), (0.0, 0.0, 0.1), (0.2, 0.0, 0.4)
    sent = [
        encoder.frame(raw_imu(BOOT_US + 10_000 * k, (0.01 * (k % 7), 0.0, -9.8), gyr, mag), 0)
        for k in range(2000)
    ]
    del sent[1000 : 1000 + lost]
    events = Wire().play([(10_000 * n, "a", data) for n, data in enumerate(sent)])
    assert len(only(Imu, events)) == len(sent)
    assert not only(ClockReset, events)


def test_a_lost_link_leaves_no_address_behind_but_what_is_known_of_copies():
    """As many more as the gate remembers can come before it drops who is silent."""
    wire, data = Wire(), [each for _, each in flight(1.0)][7]
    wire.play([(0, "a", data)])
    beats = [FrameEncoder(VehicleId(2 + n % 250, n // 250)).frame(heartbeat(2, 3), 0)
             for n in range(2 * MOST_SENDERS - 2)]  # fmt: skip
    wire.play([(3 * S, "a", beat) for beat in beats[: MOST_SENDERS - 1]])
    wire.gate.forget()
    wire.play([(4 * S, "a", beat) for beat in beats[MOST_SENDERS - 1 :]])
    assert refused(wire.play([(5 * S, "b", data)])) == {"duplicate": 1}


class Sender:
    """Three frames a sample, 50 samples a second."""

    def __init__(self, number, seed=0):
        self.encoder, self.rng = FrameEncoder(VEHICLE), random.Random(seed)
        for _ in range(number):
            self.encoder.frame(self._message(0), 0)

    def _message(self, time_us):
        return raw_imu(time_us, (self.rng.random(), 0.0, -9.8), (0.0, 0.0, 0.0), (0.2, 0.0, 0.4))

    def sample(self, time_us):
        return [self.encoder.frame(self._message(time_us), 0) for _ in range(3)]


def reported(chunks, interval_us=20_000, gate=None, begin_us=S):
    gate, reader, events = gate or FrameGate(Policy()), FrameReader(), []
    for number, chunk in enumerate(chunks):
        now_us = begin_us + number * interval_us
        gate.let_in(reader.feed(b"".join(chunk)), "a", now_us)
        events += gate.take_refused(now_us)
    return [event.text for event in only(Notice, events)]


@pytest.mark.parametrize("number", [0, 1, 45, 60, 100, 255])
@pytest.mark.parametrize("in_a_row", [1, 4, 15])
def test_two_senders_are_reported_once(number, in_a_row):
    """Also where both count the same numbers."""
    one, other = Sender(0, 1), Sender(number, 2)
    senders = [one] * in_a_row + [other] * in_a_row
    chunks = [senders[k % len(senders)].sample(20_000 * k) for k in range(1500)]
    (line,) = reported(chunks, 10_000)
    assert line == (
        "system 1: two senders use its address on one wire: two vehicles, or one by two ways"
    )


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("kind", ["lost", "late", "twice", "shuffled"])
def test_a_bad_link_of_one_sender_is_none(kind, share):
    rng, one, late, chunks = random.Random(4), Sender(0), [], []
    for k in range(3000):
        chunk = []
        for frame in one.sample(20_000 * k):
            if rng.random() >= share:
                chunk.append(frame)
            elif kind == "late":
                late.append(frame)
            elif kind == "twice":
                chunk += [frame, frame]
        if kind == "shuffled" and rng.random() < share:
            rng.shuffle(chunk)
        if rng.random() < 0.3:
            chunk += late
            late = []
        chunks.append(chunk)
    assert reported(chunks) == []


def test_nor_are_two_ways_of_which_one_is_slower():
    """Of frames from before a look begins it sees only the slower way's copies."""
    one, gate = Sender(0), FrameGate(Policy())
    samples = [one.sample(20_000 * k) for k in range(1000)]
    assert reported([a + b for a, b in zip(samples[7:], samples, strict=False)]) == []
    assert reported([[], *samples[:20]], gate=gate) == []
    pairs = [a + b for a, b in zip(samples[20:200], samples, strict=False)]
    assert reported(pairs, gate=gate, begin_us=S + EVERY_US) == []


def test_one_that_comes_later_is_reported_at_the_next_look():
    one, other, gate = Sender(0), Sender(9, 2), FrameGate(Policy())
    alone = [one.sample(20_000 * k) for k in range(150)]
    assert reported(alone, gate=gate) == []
    after = [s.sample(20_000 * k) for k in range(1500) for s in (one, other)]
    assert len(reported(after, 10_000, gate, S + EVERY_US // 2)) == 1  # within two stretches
