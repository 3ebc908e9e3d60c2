from types import SimpleNamespace

import pytest

from drivers.events import Malformed
from drivers.player import MAX_GAP_US, Player


def player_of(stamps_us, speed):
    """Plays events with these stamps by a clock that passes only when somebody sleeps."""
    clock = SimpleNamespace(now_s=100.0)

    def sleep(seconds):
        clock.now_s += seconds

    events = [Malformed(stamp, 1) for stamp in stamps_us]
    return Player(events, speed, lambda: clock.now_s, sleep), clock


def played(stamps_us, speed=1.0):
    """Pairs of (event's stamp, seconds since the start when it was drained)."""
    player, clock = player_of(stamps_us, speed)
    out = []
    for _ in range(100_000):
        if player.is_finished():
            return out
        out += [(e.arrival_us, clock.now_s - 100.0) for e in player.drain(0.05)]
        assert player.now_us() >= (out[-1][0] if out else 0)
    raise AssertionError("the player does not end")


@pytest.mark.parametrize("speed", [0.5, 1.0, 8.0])
def test_events_come_at_their_pace(speed):
    stamps = [7_000_000 + n * 20_000 for n in range(100)]
    for stamp, at_s in played(stamps, speed):
        due_s = (stamp - stamps[0]) * 1e-6 / speed
        assert due_s - 1e-6 <= at_s < due_s + 1e-3


def test_gaps_are_silence_but_broken_stamps_are_skipped():
    hour = 3_600_000_000
    stamps = [0, 10_000_000, 10_000_000 + 100 * hour, 10_020_000 + 100 * hour, 5_000_000, 5_020_000]
    times = [at_s for _, at_s in played(stamps)]
    assert times[1] == pytest.approx(10.0, abs=1e-3)
    assert times[2] == pytest.approx(10.0, abs=0.06)
    assert times[-1] == pytest.approx(10.04, abs=0.1)
    assert stamps[2] - stamps[1] > MAX_GAP_US


def test_a_service_that_cannot_keep_up_sees_no_silence():
    player, clock = player_of(range(0, 10_000_000, 20_000), 50.0)
    last_us = 0
    while not player.is_finished():
        for event in player.drain(0.01):
            last_us = event.arrival_us
            clock.now_s += 0.005  # each event takes ten times as long as it may
        assert player.now_us() - last_us <= 20_000


@pytest.mark.parametrize(("stall_s", "waited_s"), [(0.09, 0.0), (0.3, 10.0)])
def test_events_wait_for_a_service_that_is_a_tenth_of_a_second_behind(stall_s, waited_s):
    """Of the host's time; at a speed of 50, so that 0.2 s are 10 s of the events'."""
    player, clock = player_of(range(0, 40_000_000, 20_000), 50.0)
    player.drain(0.01)
    clock.now_s += stall_s
    player.drain(0.01)
    assert player.waited_s == pytest.approx(waited_s, abs=0.1)
