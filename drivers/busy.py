"""How much of its time a thread spends at work."""

import time
from collections.abc import Callable

WINDOW_S = 0.25


class BusyShare:
    """The share of the last window of time in which its thread did not rest.

    By the wall's clock: a thread that waits for the processor, or for Python's lock, is busy, too,
    because it would be at work. The thread calls :meth:`rest` and :meth:`work` in turn; any thread
    may read :attr:`share`.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self.share = 0.0
        self.windows = 0  # whole ones so far
        self._now_s = now_s
        self._window_s = self._since_s = now_s()
        self._rest_s = 0.0

    def rest(self) -> None:
        """What follows is waiting for something to do."""
        self._since_s = self._now_s()

    def work(self) -> None:
        """The waiting is over."""
        now_s = self._now_s()
        self._rest_s += now_s - self._since_s
        self._close_window(now_s)

    def go_on(self) -> None:
        """There was no time to rest."""
        self._close_window(self._now_s())

    def _close_window(self, now_s: float) -> None:
        if now_s - self._window_s >= WINDOW_S:
            self.share = max(0.0, 1.0 - self._rest_s / (now_s - self._window_s))
            self.windows += 1
            self._window_s, self._rest_s = now_s, 0.0
