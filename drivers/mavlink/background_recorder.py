"""A recorder that keeps nobody waiting: a slow disk must not make attitudes late."""

import threading
from collections import deque

from drivers.closing import Closing
from drivers.mavlink.recorder import Records, SharedRecorder

MOST_WAITING_BYTES = 32_000_000  # a disk that stands still for longer costs frames
CLOSE_S = 2.0


class BackgroundRecorder(Closing):
    """Hands frames to a recorder in a thread of its own.

    Policy when full: new ones are lost, and the recorder is told.
    """

    def __init__(self, recorder: SharedRecorder) -> None:
        self._recorder = recorder
        self._waiting: deque[Records] = deque()
        self._waiting_bytes = 0
        self._is_closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="mavlink-recorder", daemon=True)
        self._thread.start()

    def write(self, records: Records) -> None:
        """See :class:`~drivers.mavlink.recorder.SharedRecorder`."""
        if not records.frames:
            return
        with self._changed:
            if self._waiting_bytes + len(records.data) > MOST_WAITING_BYTES:
                self._recorder.miss(records.frames)
                return
            self._waiting.append(records)
            self._waiting_bytes += len(records.data)
            self._changed.notify()

    def miss(self, frames: int) -> None:
        """See :class:`~drivers.mavlink.recorder.SharedRecorder`."""
        if frames:
            self._recorder.miss(frames)

    def close(self) -> None:
        """Write what waits, for at most two seconds, and end."""
        with self._changed:
            self._is_closing = True
            self._changed.notify()
        self._thread.join(CLOSE_S)
        with self._changed:
            if self._thread.is_alive():
                self._recorder.miss(1 + sum(each.frames for each in self._waiting))

    def _work(self) -> None:
        while (waiting := self._next()) is not None:
            for records in waiting:
                self._recorder.write(records)

    def _next(self) -> list[Records] | None:
        """All that waits; None at the end."""
        with self._changed:
            while not self._waiting and not self._is_closing:
                self._changed.wait()
            if not self._waiting:
                return None
            waiting = list(self._waiting)
            self._waiting.clear()
            self._waiting_bytes = 0
            return waiting
