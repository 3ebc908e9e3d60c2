"""Two sequence counters with one address, and what only looks like them."""

import random

import pytest

from drivers.events import Notice, VehicleId
from drivers.mavlink.encoder import FrameEncoder, raw_imu
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import EVERY_US, FrameGate, Policy

ONE = VehicleId(1, 1)
S = 1_000_000


class Sender:
    """Three frames a sample, 50 samples a second."""

    def __init__(self, number, seed=0):
        self.encoder, self.rng = FrameEncoder(ONE), random.Random(seed)
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
    return [event.text for event in events if isinstance(event, Notice)]


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
    one = Sender(0)
    samples = [one.sample(20_000 * k) for k in range(1000)]
    assert reported([a + b for a, b in zip(samples[7:], samples, strict=False)]) == []


def test_one_that_comes_later_is_reported_at_the_next_look():
    one, other, gate = Sender(0), Sender(9, 2), FrameGate(Policy())
    alone = [one.sample(20_000 * k) for k in range(150)]
    assert reported(alone, gate=gate) == []
    after = [s.sample(20_000 * k) for k in range(1500) for s in (one, other)]
    assert len(reported(after, 10_000, gate, S + EVERY_US // 2)) == 1  # within two stretches


def test_nor_are_they_where_a_look_begins_among_what_is_late():
    """Of frames that came before it only the slower way's copies are seen."""
    one, gate = Sender(0), FrameGate(Policy())
    samples = [one.sample(20_000 * k) for k in range(200)]
    assert reported([[], *samples[:20]], gate=gate) == []
    pairs = [a + b for a, b in zip(samples[20:], samples, strict=False)]
    assert reported(pairs, gate=gate, begin_us=S + EVERY_US) == []
