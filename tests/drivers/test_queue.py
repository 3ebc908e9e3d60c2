"""The queue's policy, and the summary of repeated errors."""

import threading

import pytest

from drivers.events import Malformed
from drivers.mavlink.error_summary import ErrorSummary
from drivers.queue import EventQueue


def events(*numbers):
    return [Malformed(number, 1) for number in numbers]


def test_a_full_queue_drops_the_oldest_and_counts_them():
    queue = EventQueue(capacity=3)
    queue.put(events(1, 2))
    queue.put(events(3, 4, 5))
    assert queue.dropped == 2
    assert queue.drain(0) == events(3, 4, 5)
    queue.put(events(*range(10)))
    assert queue.drain(0) == events(7, 8, 9)
    assert queue.dropped == 9


def test_drain_waits_for_the_first_event_and_takes_all():
    queue = EventQueue(capacity=10)
    thread = threading.Thread(target=queue.put, args=(events(1, 2),))
    thread.start()
    assert queue.drain(10) == events(1, 2)
    thread.join()
    assert queue.drain(0.001) == []


def test_closing_wakes_the_consumer():
    queue = EventQueue(capacity=10)
    thread = threading.Thread(target=queue.close)
    thread.start()
    assert queue.drain(10) == []
    thread.join()
    assert queue.closed


def test_an_error_comes_after_what_was_there():
    queue = EventQueue(capacity=10)
    queue.put(events(1))
    queue.close(RuntimeError("broken"))
    assert queue.drain(1) == events(1)
    with pytest.raises(RuntimeError, match="broken"):
        queue.drain(1)


def test_repeated_errors_are_summarised():
    summary = ErrorSummary(repeat_s=60)
    assert summary.line("refused", 0) == "refused"
    assert [summary.line("refused", t) for t in range(1, 60)] == [None] * 59
    assert summary.line("refused", 60) == "refused (61 times)"
    assert summary.line("refused", 61) is None
    assert summary.line("unreachable", 62) == "unreachable"
    assert summary.clear() == 1
    assert summary.line("unreachable", 63) == "unreachable"
