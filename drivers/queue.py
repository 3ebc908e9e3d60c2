"""Events between the thread that reads and the one that consumes."""

from collections import deque
from collections.abc import Iterable
from threading import Condition

from drivers.events import Event


class EventQueue:
    """A bounded queue. Policy when full: the oldest events are dropped and counted.

    A consumer that is late wants the newest attitude; what it missed shows as
    a gap in the samples and in ``dropped``.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._events: deque[Event] = deque()
        self._changed = Condition()
        self._error: BaseException | None = None
        self._closed = False
        self.dropped = 0

    def put(self, events: Iterable[Event]) -> None:
        """Append ``events``, dropping the oldest if there are too many."""
        with self._changed:
            self._events.extend(events)
            excess = len(self._events) - self._capacity
            for _ in range(excess):
                self._events.popleft()
            self.dropped += max(0, excess)
            self._changed.notify()

    def close(self, error: BaseException | None = None) -> None:
        """Let no consumer wait any longer; an ``error`` is raised to the next one."""
        with self._changed:
            self._closed = True
            self._error = error
            self._changed.notify()

    @property
    def closed(self) -> bool:
        """Whether nothing more can come."""
        return self._closed

    def drain(self, timeout_s: float) -> list[Event]:
        """All events that are there, after waiting at most ``timeout_s`` for the first."""
        with self._changed:
            if not self._events and not self._closed and timeout_s > 0:
                self._changed.wait_for(lambda: self._events or self._closed, timeout_s)
            if not self._events and self._error is not None:
                raise self._error
            events = list(self._events)
            self._events.clear()
            return events
