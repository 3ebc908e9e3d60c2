"""Events as a live source, at the pace of their stamps or faster: a log, or ``sim:``."""

import time
from collections.abc import Callable, Iterable

from drivers.events import Event, ImuInUse

# A stamp further ahead or further back than this is broken, or begins another recording in the same
# file: the player goes on from there without waiting.
MAX_GAP_US = 600_000_000
MAX_BACK_US = 1_000_000
# When the service cannot keep up with the speed, or the computer slept, the events wait rather than
# rush: silence that the recorder did not hear must not appear, nor an overloaded computer look like
# an estimator that fails. In seconds of the host.
MAX_BEHIND_S = 0.1


class Player:
    """Plays events by their arrival stamps.

    The player has a clock of its own, ``now_us``, in the events' time: it runs
    ``speed`` times as fast as the host's, so that silence in a log is as long
    for the service as it was for the recorder. It ``is_finished`` behind the last event, and has
    waited for the service for ``waited_s``. ``follow`` takes what knows which IMU is in use.
    """

    dropped = shed = lost = 0  # nothing ever is

    def __init__(
        self,
        events: Iterable[Event],
        speed: float,
        monotonic_s: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
        follow: Callable[[ImuInUse], None] = lambda _: None,
    ) -> None:
        self._events = iter(events)
        self._speed = speed
        self.follow = follow
        self._monotonic_s = monotonic_s
        self._sleep = sleep
        self._next = next(self._events, None)
        self._base_us = 0 if self._next is None else self._next.arrival_us
        self._base_s = monotonic_s()
        self._last_us = self._base_us
        self.waited_s = 0.0

    def is_finished(self) -> bool:
        """Whether all events have been drained."""
        return self._next is None

    def now_us(self) -> int:
        """The events' time; it does not pass one that has not been drained."""
        following_us = self._last_us if self._next is None else self._next.arrival_us
        return min(self._running_us(), max(following_us, self._last_us))

    def _running_us(self) -> int:
        return self._base_us + round((self._monotonic_s() - self._base_s) * 1e6 * self._speed)

    def drain(self, timeout_s: float) -> list[Event]:
        """All events whose time has come, after waiting at most ``timeout_s`` for the first."""
        events = self._take_due()
        if events or self._next is None:
            return events
        ahead_s = (self._next.arrival_us - self._running_us()) / (1e6 * self._speed)
        self._sleep(max(0.0, min(timeout_s, ahead_s)))
        return self._take_due()

    def _take_due(self) -> list[Event]:
        events, now_us = list[Event](), self._running_us()
        if self._next is not None and self._next.arrival_us >= self._last_us:
            latest_us = self._next.arrival_us + round(MAX_BEHIND_S * 1e6 * self._speed)
            if now_us > latest_us:  # the events wait for the service
                self.waited_s += 1e-6 * (now_us - latest_us)
                self._base_us, self._base_s = latest_us, self._monotonic_s()
                now_us = latest_us
        while self._next is not None:
            step_us = self._next.arrival_us - self._last_us
            if step_us > MAX_GAP_US or step_us < -MAX_BACK_US:
                if events:
                    break  # what is there belongs to the old time
                self._last_us = self._base_us = now_us = self._next.arrival_us
                self._base_s = self._monotonic_s()
            if self._next.arrival_us > now_us:
                break
            self._last_us = self._next.arrival_us
            events.append(self._next)
            self._next = next(self._events, None)
        return events
