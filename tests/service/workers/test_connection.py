"""Both ends in one process: nothing waits for anybody."""

import socket
import time

import pytest

from service.workers.connection import MOST_WAITING_BYTES, Connection, Kind, Message


@pytest.fixture
def ends():
    pair = [Connection(end) for end in socket.socketpair()]
    yield pair
    for end in pair:
        end.close()


def received(end, count):
    messages = []
    until_s = time.monotonic() + 10.0
    while len(messages) < count and time.monotonic() < until_s:
        end.wait(0.1)
        messages += end.receive()
    return messages


def test_messages_of_any_size_come_whole_and_in_order(ends):
    ours, theirs = ends
    bodies = [b"", b"a", bytes(3_000_000), b"end"]
    for body in bodies:
        ours.put(Kind.OUTPUTS, body)
    got = []
    while len(got) < len(bodies):
        ours.flush()
        got += theirs.receive()
    assert got == [Message(Kind.OUTPUTS, body) for body in bodies]


def test_the_first_alone_leaves_the_rest_for_later(ends):
    ours, theirs = ends
    ours.put(Kind.JOB, b"job")
    ours.put(Kind.FRAMES, b"frames")
    assert theirs.receive_one() == Message(Kind.JOB, b"job")
    assert theirs.receive() == [Message(Kind.FRAMES, b"frames")]


def test_when_nobody_takes_them_the_oldest_frames_go_and_nothing_else(ends):
    ours, theirs = ends
    dropped = []
    size = MOST_WAITING_BYTES // 16
    for number in range(64):
        dropped += ours.put(Kind.FRAMES, number.to_bytes(2, "big") + bytes(size))
        if number == 10:
            ours.put(Kind.PROFILE, b"profile")
    ours.put(Kind.JOB, b"job")
    assert ours.lag_s > 0.0
    assert ours.dropped == len(dropped)
    got = []
    while not got or got[-1].kind is not Kind.JOB:
        ours.flush()
        got += theirs.receive()
    numbers = [int.from_bytes(m.body[:2], "big") for m in got if m.kind is Kind.FRAMES]
    gone = [int.from_bytes(body[:2], "big") for body in dropped]
    # what the system had taken already, and the newest
    assert gone == list(range(gone[0], gone[-1] + 1))
    assert numbers == [*range(gone[0]), *range(gone[-1] + 1, 64)]
    assert 1 <= gone[0] < 10 < 48 < gone[-1]
    assert Message(Kind.PROFILE, b"profile") in got


def test_attitudes_that_nobody_takes_go_when_they_are_old(ends, monkeypatch):
    ours, theirs = ends
    body = bytes(100_000)
    while ours.flush():
        ours.put(Kind.ATTITUDES, body)
    ours.put(Kind.ATTITUDES, body)
    monkeypatch.setattr("service.workers.connection.STALE_S", -1.0)
    assert ours.put(Kind.FRAMES, b"frames") == [body]
    monkeypatch.setattr("service.workers.connection.STALE_S", 60.0)
    assert ours.put(Kind.ATTITUDES, b"behind frames, which do not go") == []
    got = []
    while not got or got[-1].body != b"behind frames, which do not go":
        ours.flush()
        got += theirs.receive()
    assert Message(Kind.FRAMES, b"frames") in got


def test_what_was_put_before_the_end_still_comes_and_answers_can_be_sent(ends):
    ours, theirs = ends
    ours.put(Kind.FRAMES, b"last")
    ours.end_sending()
    assert received(theirs, 1) == [Message(Kind.FRAMES, b"last")]
    theirs.wait(1.0)
    assert theirs.receive() == []
    assert theirs.is_ended
    theirs.put(Kind.COUNTS, b"counts")
    assert theirs.flush_all(1.0)
    assert received(ours, 1) == [Message(Kind.COUNTS, b"counts")]
    assert not ours.is_ended


def test_a_process_that_is_gone_is_noticed_by_both_directions(ends):
    ours, theirs = ends
    theirs.close()
    ours.wait(1.0)
    assert ours.receive() == []
    assert ours.is_ended
    ours.put(Kind.FRAMES, bytes(100))  # no exception
    assert not ours.flush_all(0.1)
