"""The loop of a service with workers: the link's events and what workers tell, to the sinks."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.events import (
    Event,
    LinkDown,
    LinkUp,
    Malformed,
    Notice,
    RefusedFrames,
    Shed,
    VehicleId,
)
from drivers.source import LiveSource
from service.link_lines import LinkLines
from service.overload import Overload
from service.records import Departed, Message, Output, Published
from service.signals import Stoppable
from service.sinks.outbox import OutputTaker
from service.steady import steady
from service.workers.crew import Crew
from service.workers.handout import Handout
from service.workers.report import record_of

TURN_S = 0.1
READ_S = 0.1
SETTLE_S = 0.05
OVERLOADED = "overloaded: more arrives than can be read and handed out; some of it is lost"
NO_LONGER = "no longer overloaded: all that arrives is handed out"
SHOW_S = 0.1  # attitudes are decoded so often for those who look at them


class Foreman(Stoppable):
    """Runs until stopped. With ``shows`` attitudes that came encoded are shown to all sinks, too.

    Of each vehicle the last one, a few times a second: as often as a person or a scrape looks.
    """

    def __init__(
        self, source: LiveSource, crew: Crew, handout: Handout, outbox: OutputTaker, *, shows: bool
    ) -> None:
        super().__init__()
        self._source = source
        self._crew = crew
        self._handout = handout
        self._outbox = outbox
        self._shows = shows
        self._show_due_s = 0.0
        self._shown: dict[VehicleId, bytes] = {}
        self._lines = LinkLines()
        self._overload = Overload(OVERLOADED, NO_LONGER)
        self._events: deque[Event] = deque()  # few: everything about vehicles is handed out
        self._failure: BaseException | None = None

    def run(
        self, seconds: float | None = None, is_over: Callable[[], bool] = lambda: False
    ) -> None:
        """Loop until stopped or over, or for ``seconds`` if given."""
        end_s = None if seconds is None else time.monotonic() + seconds
        with steady(), self._reading():
            while not self.was_stopped and not is_over():
                if end_s is not None and time.monotonic() >= end_s:
                    break
                self._put(self._crew.turn(TURN_S) + self._heard())
                # until these are published there is no use in taking more: workers then make fewer
                self._outbox.settle(SETTLE_S)
        self._put(self._heard() + self._crew.end())

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Have the link read in a thread of its own: this one waits for the workers."""
        ended = threading.Event()

        def read() -> None:
            try:
                handed = self._handout.handed
                while not ended.is_set():
                    self._events.extend(self._source.drain(READ_S))
                    if self._handout.handed != handed:
                        handed = self._handout.handed
                        time.sleep(self._crew.job.gather_s)
            except BaseException as error:  # noqa: BLE001 - raised again by the loop
                self._failure = error

        reader = threading.Thread(target=read, name="link reader", daemon=True)
        reader.start()
        try:
            yield
        finally:
            ended.set()
            reader.join(2.0 * READ_S)

    def _heard(self) -> list[Output]:
        """The outputs from the link's reports about itself."""
        if self._failure is not None:
            raise self._failure
        outputs: list[Output] = []
        while self._events:
            outputs += self._handle(self._events.popleft())
        return outputs

    def _put(self, outputs: list[Output]) -> None:
        status = self._crew.status
        status.dropped = sum(
            each.dropped for each in (self._source, self._handout, self._crew, self._outbox)
        )
        status.lost = self._source.lost
        now_s = time.monotonic()
        if self._overload.observe(status.lost + self._handout.dropped, now_s):
            status.is_overloaded = self._overload.is_on
            outputs = [*outputs, Message(self._overload.line)]
        if self._shows and now_s >= self._show_due_s:
            self._show_due_s = now_s + SHOW_S
            outputs = outputs + self._fresh()
        for output in outputs:
            if isinstance(output, Departed):
                self._shown.pop(output.vehicle, None)
        self._outbox.put(outputs)

    def _fresh(self) -> list[Output]:
        """The attitudes that have come since the last call, of each vehicle the last one."""
        fresh: list[Output] = []
        for vehicle, payload in self._crew.payloads.items():
            if self._shown.get(vehicle) is not payload:
                self._shown[vehicle] = payload
                fresh.append(Published(vehicle, record_of(payload)))
        return fresh

    def _handle(self, event: Event) -> list[Output]:
        """What the link says of itself; everything about vehicles comes from the workers."""
        status = self._crew.status
        match event:
            case RefusedFrames():
                status.refuse(event)
            case Shed():
                status.shed(event)
            case Malformed(frames=frames):
                status.malformed += frames
            case LinkUp() | LinkDown():
                return [Message(self._lines.line(event))]
            case Notice(text=text):
                return [Message(text)]
        return []
