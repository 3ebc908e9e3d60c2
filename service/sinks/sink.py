"""What a sink is: a place where records go. Each has a thread that keeps it off the loop."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import wait
from typing import Any, Protocol

from drivers.resources import Closing, run_in_thread
from service.records import Message, Output


class Sink(Protocol):
    """Somewhere outputs go. All calls come from one thread at a time, the sink's own.

    It may have ``handle_at_once(outputs)``, which returns what cannot be done at once: while
    nothing else is pending the loop calls that itself, since to wake a thread costs more than some
    records. One with a ``rest_s`` is for eyes: its thread rests that long after each look, and then
    hands over all that is pending at one go.
    """

    name: str  # what lines for a person call it

    def handle(self, outputs: Sequence[Output]) -> None:
        """Take the outputs of a turn of the loop; may block or raise without harm to others."""

    def close(self) -> None:
        """Release everything; called once."""


# Turns of the loop a sink may lag behind; with hundreds of vehicles a turn takes 2 ms.
MAX_PENDING = 512
# What has waited longer is stale, at any rate.
LONGEST_WAIT_S = 0.6


class Outlet:
    """Runs a sink in a thread of its own, so that it can neither stop nor break the loop.

    The queue is bounded: when the sink lags, the oldest outputs are dropped and
    counted, because the newest attitude is worth most.
    """

    def __init__(self, sink: Sink, report: Callable[[str], None]) -> None:
        self.sink = sink
        self.dropped = 0
        self._report = report  # a line on an error
        self._errors = 0
        self._pending: deque[tuple[float, Sequence[Output]]] = deque()  # and since when, s
        self.is_busy = False  # something is pending, or in hand
        self._handle_at_once: Callable[..., Any] | None = getattr(sink, "handle_at_once", None)
        self._rest_s: float = getattr(sink, "rest_s", 0.0)
        self._is_closing = False
        self._changed = threading.Condition()
        self.closed = run_in_thread(self._work, f"sink {sink.name}")

    def put(self, outputs: Sequence[Output]) -> None:
        """Hand over outputs; never blocks."""
        if self._handle_at_once is not None and not self.is_busy:
            outputs = self._result(self._handle_at_once, outputs)
            if not outputs:
                return
        now_s = time.monotonic()
        with self._changed:
            while len(self._pending) >= MAX_PENDING or (
                self._pending and now_s - self._pending[0][0] > LONGEST_WAIT_S
            ):
                self.dropped += len(self._pending.popleft()[1])
            self._pending.append((now_s, outputs))
            if not self.is_busy:
                self.is_busy = True
                self._changed.notify()

    def begin_close(self) -> None:
        """Have the sink closed once it has taken what is pending; does not wait for that."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()

    def _work(self) -> None:
        while (outputs := self._next()) is not None:
            self._result(self.sink.handle, outputs)
        self._result(self.sink.close)

    def _next(self) -> Sequence[Output] | None:
        with self._changed:
            if self.is_busy and self._rest_s > 0.0:
                self._changed.wait_for(lambda: self._is_closing, self._rest_s)
            self.is_busy = bool(self._pending)
            self._changed.wait_for(lambda: self._pending or self._is_closing)
            if not self._pending:
                return None
            turns = len(self._pending) if self._rest_s > 0.0 else 1
            return [output for _ in range(turns) for output in self._pending.popleft()[1]]

    def _result(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """What a call returns. Errors are counted; the first and every hundredth are reported."""
        try:
            return call(*arguments)
        except BaseException as error:  # noqa: BLE001 - whatever it does, the others go on
            if self._errors % 100 == 0:
                self._report(f"{self.sink.name}: {error or type(error).__name__}")
            self._errors += 1


CLOSE_TIMEOUT_S = 0.7  # for all sinks together: the command ends within a second


class Outbox(Closing):
    """The sinks of a run, each behind its own outlet."""

    def __init__(self, sinks: Iterable[Sink] = ()) -> None:
        self.stuck: list[str] = []
        self.unreported: list[str] = []  # lines on errors; after the end, those that came last
        self._outlets: list[Outlet] = []
        for sink in sinks:
            self.add(sink)

    @property
    def dropped(self) -> int:
        """Records that lagging sinks lost."""
        return sum(outlet.dropped for outlet in self._outlets)

    @property
    def sinks(self) -> list[Sink]:
        """All of them, in the order in which they were added."""
        return [outlet.sink for outlet in self._outlets]

    def add(self, sink: Sink) -> None:
        """Have one more, which is closed with the others."""
        self._outlets.append(Outlet(sink, self.unreported.append))

    def put(self, outputs: Sequence[Output]) -> None:
        """Hand outputs to every sink, and one sink's errors to all; never blocks."""
        while self.unreported:
            outputs = [*outputs, Message(self.unreported.pop(0))]
        if outputs:
            for outlet in self._outlets:
                outlet.put(outputs)

    def close(self) -> None:
        """Deliver what is pending and close every sink; ``stuck`` names those that hang."""
        for outlet in self._outlets:
            outlet.begin_close()
        closed, _ = wait([outlet.closed for outlet in self._outlets], CLOSE_TIMEOUT_S)
        self.stuck += [each.sink.name for each in self._outlets if each.closed not in closed]
