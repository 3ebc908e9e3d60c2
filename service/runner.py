"""The only loop: source to pipeline to sinks, on an absolute schedule.

Tick n is due at start + n periods, so ticks do not drift. A tick that starts
more than a period late is an overrun: counted, published, and made up for at
once, so that the rate holds over a short stall. After a long one (a suspended
computer), and while there is more to do than can be done, the missed ticks are skipped.
"""

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from drivers.busy import BusyShare
from drivers.events import Event
from service.load import Load
from service.newest import newest_events
from service.overload import Overload, Shedding
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.records import Message, Output
from service.sinks.outbox import OutputTaker

MAX_CATCH_UP_S = 0.25
# At most so many events between two looks at the schedule: a backlog must not delay the ticks.
MOST_EVENTS = 64
# Records that wait this long for their sink mean that there is no time left for it.
LAG_S = 0.25
# Between ticks the loop looks at its stop flag and mailbox this often.
MAX_WAIT_S = 0.1


class LiveSource(Protocol):
    """What the loop needs of a source."""

    @property
    def dropped(self) -> int:
        """Events thrown away because the loop was too slow."""

    @property
    def busy(self) -> float:
        """The share of its time that a thread of the source works."""

    def drain(self, timeout_s: float) -> list[Event]:
        """All events that wait, after waiting at most ``timeout_s`` for the first."""

    def spare(self, interval_s: float) -> None:
        """Give each vehicle's newest samples alone, once in ``interval_s``; 0 gives all."""


class Runner:
    """Runs a pipeline until stopped.

    ``now_us`` is the host time that arrivals are stamped with (Unix time for
    live sources); ``is_finished`` tells that nothing will come any more. With an ``overload``
    samples and attitudes are left out where there is more to do than can be done.
    """

    def __init__(
        self,
        source: LiveSource,
        pipeline: Pipeline,
        outbox: OutputTaker,
        *,
        rate_hz: float,
        now_us: Callable[[], int] = lambda: time.time_ns() // 1000,
        requests: ParameterRequests | None = None,
        is_finished: Callable[[], bool] = lambda: False,
        overload: Overload | None = None,
    ) -> None:
        self.overruns = 0
        self.ticks = 0
        self._source = source
        self._pipeline = pipeline
        self._outbox = outbox
        self._period_s = 1.0 / rate_hz
        self._now_us = now_us
        self._requests = requests
        self._is_finished = is_finished
        self._overload = overload
        self._busy = BusyShare()
        self._windows = 0  # of the busy share, that were looked at
        self._stop = threading.Event()
        self._waiting: deque[Event] = deque()  # bounded by what the source keeps

    def stop(self) -> None:
        """End the loop at its next turn; from any thread or signal handler."""
        self._stop.set()

    @property
    def was_stopped(self) -> bool:
        """Whether somebody asked for the end."""
        return self._stop.is_set()

    def run(
        self, seconds: float | None = None, is_over: Callable[[], bool] = lambda: False
    ) -> None:
        """Loop until stopped or over, for ``seconds`` if given, or to the end of a finite source.

        ``is_over`` is asked at every turn.
        """
        start_s = time.monotonic()
        end_s = None if seconds is None else start_s + seconds
        due_s = start_s + self._period_s
        while not self._stop.is_set() and (self._waiting or not self._is_finished()):
            now_s = time.monotonic()
            if (end_s is not None and now_s >= end_s) or is_over():
                break
            if now_s >= due_s:
                self._tick()
                due_s = self._next_due_s(due_s, now_s)
                self._shed(now_s)
            self._take(min(MAX_WAIT_S, max(0.0, due_s - time.monotonic())))
        self._tick()  # publishes what the last events have changed
        if self._requests is not None:
            self._requests.close()

    def _take(self, timeout_s: float) -> None:
        outputs: list[Output] = []
        if self._waiting:
            self._busy.go_on()
        else:
            self._busy.rest()
            self._waiting.extend(self._source.drain(timeout_s))
            self._busy.work()
        if self._overload is not None and self._overload.level > 0 and len(self._waiting) > 1:
            self._waiting = deque(newest_events(self._waiting))
        for _ in range(min(MOST_EVENTS, len(self._waiting))):
            outputs.extend(self._pipeline.handle(self._waiting.popleft()))
        if self._requests is not None:
            self._requests.serve(self._pipeline.replace_profile)
        self._outbox.put(outputs)

    @property
    def dropped(self) -> int:
        """Events and records lost so far."""
        return self._source.dropped + self._outbox.dropped

    def _tick(self) -> None:
        shedding = Shedding() if self._overload is None else self._overload.shedding
        load = Load(
            self.overruns,
            self.dropped,
            is_shedding=not shedding.is_none,
            share=shedding.attitudes,
            published_hz=1.0 / (shedding.attitudes * self._period_s),
        )
        self._outbox.put(self._pipeline.tick(self._now_us(), load))
        self.ticks += 1

    def _shed(self, now_s: float) -> None:
        """Once in a window of time, look whether more or less must be left out."""
        overload = self._overload
        if overload is None or self._busy.windows == self._windows:
            return
        self._windows = self._busy.windows
        before = overload.shedding
        busy = max(self._busy.share, self._source.busy, self._outbox.lag_s / LAG_S)
        if not overload.observe(busy, now_s):
            return
        shedding = overload.shedding
        self._source.spare(0.0 if shedding.is_none else shedding.samples * self._period_s)
        if before.is_none or shedding.is_none:
            self._outbox.put([Message(self._overload_line(shedding))])

    def _overload_line(self, shedding: Shedding) -> str:
        if shedding.is_none:
            return "no longer overloaded: every sample counts again"
        return (
            "overloaded: more arrives than this computer can handle; "
            "of each vehicle the newest samples are taken, and the ticks stay on time"
        )

    def _next_due_s(self, due_s: float, now_s: float) -> float:
        late_s = now_s - due_s
        if late_s <= self._period_s:
            return due_s + self._period_s
        if late_s <= MAX_CATCH_UP_S and (self._overload is None or self._overload.level == 0):
            self.overruns += 1
            return due_s + self._period_s
        missed = int(late_s / self._period_s)
        self.overruns += missed
        return due_s + (missed + 1) * self._period_s
