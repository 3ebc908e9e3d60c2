"""The only loop: source to pipeline to sinks, on an absolute schedule.

Tick n is due at start + n periods, so ticks do not drift. A tick that starts
more than a period late is an overrun: counted, published, and made up for at
once, so that the rate holds over a short stall. After a long one (a suspended
computer), and while there is more to do than can be done, the missed ticks are skipped.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence

from drivers.events import Event
from drivers.mavlink.readings import Readings
from drivers.source import EventSource
from service.load import Load, Losses
from service.overload import Overload
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.records import Message, Output
from service.signals import Stoppable
from service.sinks.outbox import Outbox
from service.steady import Frozen, steady

MAX_CATCH_UP_S = 0.25
# So long after a stop nobody can say yet whose silence is his own.
WAKING_S = 0.5
# At most so many events between two looks at the schedule: a backlog must not delay the ticks.
MOST_EVENTS = 64
# Between two ticks events are handled for this share of a period at least, if there are any.
LEAST_WORK = 0.5
# The loop waits for its records to be published, for this share of a period at most: meanwhile it
# would only keep Python's lock from the thread that does it.
SETTLING = 0.5
# To sleep for less than this costs more than it lasts: the tick comes that much early, then.
EARLY_S = 2e-4
# Between ticks the loop looks at its stop flag and mailbox this often.
MAX_WAIT_S = 0.1


Drain = Callable[[float], Sequence[Event | Readings]]


class Runner(Stoppable):
    """Runs a pipeline until stopped.

    ``now_us`` is the host time that arrivals are stamped with (Unix time for
    live sources), ``monotonic_s`` the clock of the schedule; ``is_finished`` tells that nothing
    will come any more. With an ``overload`` attitudes are left out, too, while the source leaves
    samples out. ``news`` is asked at each tick for lines that others have to tell, ``recording``
    for a word on the files that are recorded to.
    """

    def __init__(
        self,
        source: EventSource,
        pipeline: Pipeline,
        outbox: Outbox,
        *,
        rate_hz: float,
        now_us: Callable[[], int] = lambda: time.time_ns() // 1000,
        monotonic_s: Callable[[], float] = time.monotonic,
        requests: ParameterRequests | None = None,
        is_finished: Callable[[], bool] = bool,
        overload: Overload | None = None,
        news: Callable[[], list[Message]] = list,
        recording: Callable[[], str] = str,
    ) -> None:
        super().__init__()
        self.overruns = 0
        self.ticks = 0
        self._source = source
        # links give what nearly all frames say as rows
        self._drain: Drain = getattr(source, "drain_readings", source.drain)
        self._pipeline = pipeline
        self._outbox = outbox
        self._period_s = 1.0 / rate_hz
        self._now_us = now_us
        self._monotonic_s = monotonic_s
        self._requests = requests
        self._is_finished = is_finished
        self._overload = overload
        self._news = news
        self._recording = recording
        self._frozen = Frozen()
        self._due_s = float("inf")
        self._has_handled = False  # something, at the last turn
        self._woken_s: float | None = None  # when the loop went on after a stop
        self._waiting: deque[Event | Readings] = deque()  # bounded by what the source keeps

    @property
    def lost(self) -> int:
        """Datagrams that the system threw away before they could be read."""
        return self._source.lost

    def run(self, seconds: float | None = None, is_over: Callable[[], object] = bool) -> None:
        """Loop until stopped or over, for ``seconds`` if given, or to the end of a finite source.

        ``is_over`` is asked at every turn.
        """
        with steady() as self._frozen:
            self._loop(seconds, is_over)
        if self._requests is not None:
            self._requests.close()

    def _loop(self, seconds: float | None, is_over: Callable[[], object]) -> None:
        start_s = self._monotonic_s()
        end_s = None if seconds is None else start_s + seconds
        due_s = self._due_s = start_s + self._period_s
        busy_s = start_s  # a loop that is always late must not do nothing but tick
        while not self.was_stopped and (self._waiting or not self._is_finished()):
            now_s = self._monotonic_s()
            if (end_s is not None and now_s >= end_s) or is_over():
                break
            if now_s >= due_s - EARLY_S and (now_s >= busy_s or not self._has_handled):
                if now_s - due_s > MAX_CATCH_UP_S:
                    self._woken_s = now_s
                    self._take(0.0)  # before anybody is said to be silent
                self._tick(now_s)
                due_s = self._due_s = self._next_due_s(due_s, now_s)
                busy_s = self._monotonic_s() + LEAST_WORK * self._period_s
            self._take(min(MAX_WAIT_S, max(0.0, due_s - self._monotonic_s())))
        self._tick(self._monotonic_s())  # publishes what the last events have changed

    def _take(self, timeout_s: float) -> None:
        """Handle some of what has arrived, after waiting for it."""
        waiting = self._waiting
        if not waiting:
            waiting.extend(self._drain(timeout_s))
        outputs: list[Output] = []
        self._has_handled = bool(waiting)
        end_s = max(self._due_s, self._monotonic_s() + LEAST_WORK * self._period_s)
        for _ in range(min(MOST_EVENTS, len(waiting))):
            outputs += self._pipeline.handle(waiting.popleft())
            if self._monotonic_s() >= end_s:
                break
        if self._requests is not None:
            self._requests.serve(self._pipeline.replace_profile)
        if outputs:
            self._outbox.put(outputs)

    @property
    def dropped(self) -> int:
        """Events and records lost so far."""
        return self._source.dropped + self._outbox.dropped

    def _tick(self, now_s: float) -> None:
        if news := self._news():
            self._outbox.put(news)
        overload = self._overload
        if overload is not None and now_s >= overload.due_s:
            self._observe_load(overload, now_s)
        load = Load(
            overload is not None and overload.is_on,
            not self._outbox.settle(0.0),
            self._woken_s is not None and now_s - self._woken_s < WAKING_S,
            1.0 / self._period_s,
        )
        self._outbox.put(self._pipeline.tick_rows(self._now_us(), load, self._losses))
        self._outbox.settle(SETTLING * self._period_s)
        self._frozen.add(len(self._pipeline), now_s)
        self.ticks += 1

    def _losses(self) -> Losses:
        return Losses(self.overruns, self.dropped, self._source.lost, self._recording())

    def _observe_load(self, overload: Overload, now_s: float) -> None:
        """Tell when there begins to be more to do than can be done, and when that ends."""
        if overload.observe(self._source.shed + self._source.lost, now_s):
            self._outbox.put([Message(overload.line)])

    def _most_catch_up_s(self) -> float:
        """How late ticks may be that are made up for; live, there is little time for it."""
        if self._overload is None:
            return MAX_CATCH_UP_S
        return 0.0 if self._overload.is_on else min(MAX_CATCH_UP_S, 2.0 * self._period_s)

    def _next_due_s(self, due_s: float, now_s: float) -> float:
        late_s = now_s - due_s
        if late_s <= self._period_s:
            return due_s + self._period_s
        if late_s <= self._most_catch_up_s():
            self.overruns += 1
            return due_s + self._period_s
        missed = int(late_s / self._period_s)
        self.overruns += missed
        return due_s + (missed + 1) * self._period_s
