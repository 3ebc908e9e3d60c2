import threading
import time

from service.records import Message
from service.sinks.sink import MAX_PENDING, Outbox


class Collector:
    """Keeps what it gets."""

    name = "collector"

    def __init__(self):
        self.got, self.closed = [], False

    def handle(self, outputs):
        self.got.extend(outputs)

    def close(self):
        self.closed = True


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


def test_everything_is_delivered_before_the_close():
    sink = Collector()
    with Outbox([sink]) as outbox:
        for number in range(MAX_PENDING):
            outbox.put([Message(str(number))])
    assert [m.text for m in sink.got] == [str(n) for n in range(MAX_PENDING)]
    assert sink.closed


def test_a_sink_that_raises_is_reported_of_once_and_hurts_no_other():
    good, bad = Collector(), Raiser()
    outbox = Outbox([bad, good])
    count = 0
    while count < 60:  # until the error has come back to the loop, then on
        outbox.put([Message("x")])
        count += any(m.text.startswith("raiser") for m in [*good.got])
    outbox.close()
    texts = [m.text for m in good.got]
    reports = [text for text in texts if text.startswith("raiser")]
    assert reports[0] == "raiser: disk full, 1 lost"
    assert len(reports) <= 1 + bad.calls // 100
    assert bad.closed


def test_a_sink_that_blocks_loses_the_oldest_and_stops_nobody(monkeypatch):
    monkeypatch.setattr("service.sinks.sink.CLOSE_TIMEOUT_S", 3.0)
    slow, good = Blocker(), Collector()
    outbox = Outbox([slow, good])
    sent = 0
    while outbox.dropped < 10:
        outbox.put([Message(str(sent))])
        sent += 1
    outbox.close()
    assert outbox.stuck == ["blocker"]
    assert good.closed
    slow.release.set()


def test_what_a_lagging_sink_keeps_is_the_newest():
    slow = Blocker()
    outbox = Outbox([slow])
    for number in range(3 * MAX_PENDING):
        outbox.put([Message(str(number))] * 3)
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
        texts = [output.text for output in outputs]
        end = texts.index("3") if "3" in texts else len(texts)
        self._take(outputs[:end])
        if "bad" in texts:
            raise OSError("it broke")
        return outputs[end:]

    def _take(self, outputs):
        self.got.extend(outputs)
        self.by.extend([threading.current_thread()] * len(outputs))


def test_what_can_be_done_at_once_is_done_by_the_loop_and_overtakes_nothing():
    sink, here = Quick(), threading.current_thread()
    texts = [str(number) for number in range(6)]
    with Outbox([sink]) as outbox:
        outbox.put([Message(text) for text in texts[:5]])
        assert [output.text for output in sink.got] == texts[:3]
        outbox.put([Message(texts[5])])  # behind those that wait
        sink.release.set()
        while len(sink.got) < 6:
            time.sleep(0.01)
        outbox.put([Message("6"), Message("bad")])
        outbox.put([])  # brings the error
    assert [output.text for output in sink.got] == [*texts, "6", "bad", "quick: it broke"]
    assert [thread is here for thread in sink.by] == [True] * 3 + [False] * 3 + [True] * 3


def test_a_sink_for_eyes_takes_what_has_gathered_and_all_before_the_close():
    class Eyes(Collector):
        rest_s = 30.0

        def __init__(self):
            super().__init__()
            self.first = threading.Event()

        def handle(self, outputs):
            super().handle(outputs)
            self.first.set()

    sink = Eyes()
    outbox = Outbox([sink])
    outbox.put([Message("0")])
    assert sink.first.wait(60)
    outbox.put([Message("1")])
    outbox.put([Message("2")])
    time.sleep(0.05)
    assert len(sink.got) == 1
    outbox.close()
    assert [output.text for output in sink.got] == ["0", "1", "2"]
    assert not outbox.stuck
