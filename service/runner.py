"""The only loop: source to pipeline to sinks.

It wakes when something arrives, and when a record is due that waits for no sample. A wake-up that
comes more than a period late is an overrun: counted and published. What was due meanwhile is
published once; nothing is made up for.
"""

import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from math import inf

from drivers.source import EventSource
from service.parameters import ParameterRequests
from service.pipeline import Pipeline
from service.process import gc_settings
from service.records import Message, Output
from service.sinks.sink import Outbox
from service.vehicle_status import Load

# A loop that wakes so late was stopped, with the computer or by itself: for a while it is not known
# whose silence is his own.
STOPPED_S = 0.25
WAKING_S = 0.5
# Between two wake-ups for due records lies this share of a period at least.
LEAST_REST = 0.25
# Between wake-ups the loop looks at its stop flag and mailbox this often.
MAX_WAIT_S = 0.1


# Samples left out in that many windows in a row begin an overload, and as long without any end it.
WINDOW_S = 0.25
WINDOWS_TO_BEGIN = 2
WINDOWS_TO_END = 4

BEGINS = (
    "overloaded: more arrives than this computer can handle; "
    "of each vehicle the newest samples are taken, and the ticks stay on time"
)
ENDS = "no longer overloaded: every sample counts again"


class Overload:
    """Overload as a state, by a count of what has been left out so far. Times are given, in s.

    A short stall leaves something out, too, and is none.
    """

    def __init__(self) -> None:
        self.is_on = False
        self.due_s = -inf  # before that a count means nothing
        self._count = inf  # before the first
        self._windows = 0  # in a row that speak against the present state

    def observe(self, left_out: int, now_s: float) -> str:
        """Take the count at ``now_s``; a line for a person if the overload begins or ends."""
        if now_s < self.due_s:
            return ""
        before, self._count, self.due_s = self._count, left_out, now_s + WINDOW_S
        is_full = left_out > before
        self._windows = self._windows + 1 if is_full != self.is_on else 0
        if self._windows < (WINDOWS_TO_END if self.is_on else WINDOWS_TO_BEGIN):
            return ""
        self.is_on, self._windows = not self.is_on, 0
        return BEGINS if self.is_on else ENDS


@dataclass
class Runner:
    """Runs a pipeline until stopped.

    ``now_us`` is the host time that arrivals are stamped with (Unix time for live sources),
    ``monotonic_s`` the clock of the schedule; ``is_finished`` shows that nothing will come any
    more. While the source leaves samples out, attitudes are left out, too.
    ``recording`` is asked for a word on the files that are recorded to.
    """

    source: EventSource
    pipeline: Pipeline
    outbox: Outbox
    _: KW_ONLY
    rate_hz: float
    now_us: Callable[[], int] = lambda: time.time_ns() // 1000
    monotonic_s: Callable[[], float] = time.monotonic
    requests: ParameterRequests = field(default_factory=ParameterRequests)
    is_finished: Callable[[], bool] = bool
    overload: Overload = field(default_factory=Overload)
    recording: Callable[[], str] = str
    was_stopped: bool = False
    overruns: int = 0
    ticks: int = 0
    woken_s: float = -inf  # when the loop went on after a stop

    @property
    def dropped(self) -> int:
        """Events and records lost so far."""
        return self.source.dropped + self.outbox.dropped

    def stop(self) -> None:
        """Have the loop end at its next turn; from any thread or signal handler."""
        self.was_stopped = True

    def run(self, seconds: float | None = None, is_over: Callable[[], object] = bool) -> None:
        """Loop until stopped or over, for ``seconds`` if given, or to the end of a finite source.

        ``is_over`` is asked at every turn.
        """
        due_s = self.monotonic_s()
        end_s = inf if seconds is None else due_s + seconds
        with gc_settings() as add_objects:
            while not self.was_stopped and not self.is_finished():
                now_s = self.monotonic_s()
                if now_s >= end_s or is_over():
                    break
                if now_s - due_s > STOPPED_S:
                    self.woken_s = now_s
                self._take(max(0.0, min(due_s, end_s) - now_s))
                now_s = self.monotonic_s()
                if now_s >= due_s:
                    self.overruns += int((now_s - due_s) * self.rate_hz)
                    due_s = self._tick(now_s)
                    add_objects(len(self.pipeline.vehicles), now_s)
            self._tick(self.monotonic_s())  # publishes what the last events have changed
        self.requests.close()

    def _take(self, timeout_s: float) -> None:
        """Handle what has arrived, after waiting for it."""
        events = self.source.drain(timeout_s)
        handle, now_us = self.pipeline.handle, self.now_us
        outputs: list[Output] = []
        for event in events:
            outputs += handle(event, now_us())
        self.requests.serve(self.pipeline.replace_profile)
        self.outbox.put(outputs)

    def _tick(self, now_s: float) -> float:
        """Publish what is due; returns when the next record will be."""
        self.ticks += 1
        if line := self.overload.observe(self.source.shed + self.source.lost, now_s):
            self.outbox.put([Message(line)])
        is_waking, now_us = now_s - self.woken_s < WAKING_S, self.now_us()
        counts = (self.overruns, self.dropped, self.source.lost)
        load = Load(self.overload.is_on, is_waking, *counts, self.recording())
        self.outbox.put(self.pipeline.tick(now_us, load))
        wait_s = 1e-6 * (self.pipeline.wake_us - now_us)
        return now_s + min(MAX_WAIT_S, max(LEAST_REST / self.rate_hz, wait_s))
