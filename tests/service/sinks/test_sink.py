"""The outbox: every sink gets all in order, and none holds up or hurts another."""

import threading
import time

from service.records import Message
from service.sinks.sink import MAX_PENDING, Outbox
from tests.service.records import Collector
from tests.service.sessions import wait_for


def messages(*texts):
    return [Message(str(text)) for text in texts]


def texts(sink):
    return [output.text for output in sink.got]


class Raiser(Collector):
    name, calls = "raiser", 0

    def handle(self, outputs):
        self.calls += 1
        raise OSError(f"disk full, {len(outputs)} lost")


class Blocker(Collector):
    name = "blocker"

    def __init__(self):
        super().__init__()
        self.release = threading.Event()

    def handle(self, outputs):
        self.release.wait(60)
        super().handle(outputs)


def test_a_sink_that_raises_is_reported_of_once_and_hurts_no_other():
    good, bad = Collector(), Raiser()
    outbox = Outbox([bad, good])
    count = 0
    while count < 60:  # until the error has come back to the loop, then on
        outbox.put(messages("x"))
        count += any(m.text.startswith("raiser") for m in [*good.got])
    outbox.close()
    reports = [text for text in texts(good) if text.startswith("raiser")]
    assert reports[0] == "raiser: disk full, 1 lost"
    assert len(reports) <= 1 + bad.calls // 100
    assert bad.closed


def test_a_sink_that_blocks_loses_the_oldest_and_stops_nobody(monkeypatch):
    monkeypatch.setattr("service.sinks.sink.CLOSE_TIMEOUT_S", 3.0)
    slow, good = Blocker(), Collector()
    outbox = Outbox([slow, good])
    while outbox.dropped < 10:
        outbox.put(messages("x"))
    outbox.close()
    assert outbox.stuck == ["blocker"]
    assert good.closed
    slow.release.set()


def test_what_a_lagging_sink_keeps_is_the_newest():
    slow = Blocker()
    outbox = Outbox([slow])
    for number in range(3 * MAX_PENDING):
        outbox.put(messages(number) * 3)
    assert outbox.dropped % 3 == 0
    slow.release.set()
    outbox.close()
    assert not outbox.stuck
    assert slow.got[-1].text == str(3 * MAX_PENDING - 1)
    assert len(slow.got) + outbox.dropped == 9 * MAX_PENDING


class Quick(Collector):
    """Takes numbers at once, but for 3, and notes where."""

    name = "quick"

    def __init__(self):
        super().__init__()
        self.by, self.release = [], threading.Event()

    def handle(self, outputs):
        self.release.wait(60)
        self._take(outputs)

    def handle_at_once(self, outputs):
        given = [output.text for output in outputs]
        end = given.index("3") if "3" in given else len(given)
        self._take(outputs[:end])
        if "bad" in given:
            raise OSError("it broke")
        return outputs[end:]

    def _take(self, outputs):
        self.got.extend(outputs)
        self.by.extend([threading.current_thread()] * len(outputs))


def test_what_can_be_done_at_once_is_done_by_the_loop_and_overtakes_nothing():
    sink, here = Quick(), threading.current_thread()
    with Outbox([sink]) as outbox:
        outbox.put(messages(*range(5)))
        assert texts(sink) == ["0", "1", "2"]
        outbox.put(messages(5))  # behind those that wait
        sink.release.set()
        wait_for(lambda: len(sink.got) == 6)
        outbox.put(messages(6, "bad"))
        outbox.put([])  # brings the error
    assert texts(sink) == [*map(str, range(7)), "bad", "quick: it broke"]
    assert [thread is here for thread in sink.by] == [True] * 3 + [False] * 3 + [True] * 3


def test_a_sink_for_eyes_takes_what_has_gathered_and_all_before_the_close():
    sink = Collector()
    sink.rest_s = 30.0
    outbox = Outbox([sink])
    outbox.put(messages(0))
    wait_for(lambda: sink.got)
    outbox.put(messages(1))
    outbox.put(messages(2))
    time.sleep(0.05)
    assert len(sink.got) == 1
    outbox.close()
    assert texts(sink) == ["0", "1", "2"]
    assert not outbox.stuck
