"""What has arrived and waits to be looked at, while not everything can be."""

import time
from collections import deque
from collections.abc import Callable

from drivers.mavlink.transports.transport import Packet

# Datagrams or pieces of a stream, the newest. The system has room for some hundred datagrams, and
# keeps the oldest: they are taken from it at once.
MOST_WAITING = 20_000

Stamped = tuple[int, Packet]  # with its arrival, host's Unix time, us


class Backlog:
    """Gives everything at once, or all that came in an interval together.

    ``interval_s`` may be set by any thread; 0 means at once.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self.interval_s = 0.0
        self._now_s = now_s
        self._due_s = 0.0
        self._waiting: deque[Stamped] = deque(maxlen=MOST_WAITING)

    def take(self, packets: list[Packet], now_us: int) -> list[Stamped]:
        """What is to be looked at now that ``packets`` have arrived."""
        stamped = [(now_us, packet) for packet in packets]
        if self.interval_s <= 0.0 and not self._waiting:
            return stamped
        self._waiting.extend(stamped)
        now_s = self._now_s()
        if self.interval_s > 0.0 and now_s < self._due_s:
            return []
        self._due_s = now_s + self.interval_s
        waiting = list(self._waiting)
        self._waiting.clear()
        return waiting
