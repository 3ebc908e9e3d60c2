"""Messages between the service's processes, over a pair of stream sockets.

Neither side ever waits for the other: what the socket does not take stays here, and of what is
worth most when it is new the oldest is dropped when too much waits.
"""

import select
import socket
import sys
import threading
import time
from collections import deque
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

MOST_WAITING_BYTES = 4 << 20  # some 0.7 s of 400 vehicles' frames at 50 Hz, beside the system's own
STALE_S = 0.6
RECEIVE_BYTES = 1 << 18
SOCKET_BYTES = 1 << 20  # the system may give less
_HEAD = Struct("<IB")  # size of the body, kind


class Kind(IntEnum):
    """What a message is about. Those before ``LAST_DROPPABLE`` may be dropped when they are old."""

    FRAMES = 0  # to a worker: a batch of frames
    ATTITUDES = 1  # to the service: attitudes as they are published
    LAST_DROPPABLE = 1
    JOB = 2  # to a worker: what it is to do, once
    PROFILE = 3  # to a worker: a partial profile for a vehicle; to the service: the answer
    OUTPUTS = 4  # to the service: statuses, lines for a person
    OUTGOING = 5  # to the service: messages for vehicles
    COUNTS = 6  # to the service: what was counted so far, once a second and at the end
    FAILURE = 7  # to the service: why the worker ends


class Message(NamedTuple):
    """One message."""

    kind: Kind
    body: bytes


class _Waiting(NamedTuple):
    kind: Kind
    data: memoryview
    since_s: float


class Connection:
    """One end of a pair. Any thread may put; one thread receives."""

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            end.setsockopt(socket.SOL_SOCKET, option, SOCKET_BYTES)
        self.socket = end
        self.dropped = 0  # messages
        self.is_ended = False  # the other side sends no more, or is gone
        self._is_broken = False  # nothing can be sent any more
        self._lock = threading.Lock()
        self._waiting: deque[_Waiting] = deque()
        self._waiting_bytes = 0
        self._begun: memoryview | None = None  # the rest of a message of which some was sent
        self._received = bytearray()

    @property
    def lag_s(self) -> float:
        """How long the oldest message that was not sent has waited."""
        with self._lock:
            return time.monotonic() - self._waiting[0].since_s if self._waiting else 0.0

    def put(self, kind: Kind, body: bytes) -> list[bytes]:
        """Send a message, at once or when there is room; returns the bodies dropped for it."""
        data = memoryview(_HEAD.pack(len(body), kind) + body)
        with self._lock:
            self._waiting.append(_Waiting(kind, data, time.monotonic()))
            self._waiting_bytes += len(data)
            dropped = self._drop()
            self._send()
        return dropped

    def flush(self) -> bool:
        """Send what waits, as far as there is room; True if nothing is left."""
        with self._lock:
            self._send()
            return self._begun is None and not self._waiting

    def flush_all(self, timeout_s: float) -> bool:
        """Wait until all is sent; False if it was not in time."""
        end_s = time.monotonic() + timeout_s
        while not self.flush():
            left_s = end_s - time.monotonic()
            if self._is_broken or left_s <= 0.0:
                return False
            select.select([], [self.socket], [], min(left_s, 0.1))
        return True

    def receive(self) -> list[Message]:
        """All whole messages that are there; the end is told by ``is_ended`` alone."""
        self._read()
        return self._take_whole()

    def _read(self) -> None:
        while not self.is_ended:
            try:
                data = self.socket.recv(RECEIVE_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # reset: the process was killed while something was under way
                data = b""
            if not data:
                self.is_ended = True
            self._received += data
            if len(data) < RECEIVE_BYTES:
                break

    def receive_one(self) -> Message | None:
        """The first whole message, if it is there; what comes after it stays for later."""
        self._read()
        return next(iter(self._take_whole(most=1)), None)

    def wait(self, timeout_s: float) -> None:
        """Wait until there is something to receive."""
        if not self.is_ended:
            select.select([self.socket], [], [], max(0.0, timeout_s))

    def end_sending(self) -> None:
        """Tell the other side that nothing more comes, once it has received what was sent."""
        try:
            self.socket.shutdown(socket.SHUT_WR)
        except OSError:
            self.is_ended = self._is_broken = True

    def close(self) -> None:
        """Close this end."""
        self.socket.close()
        self.is_ended = self._is_broken = True

    def _take_whole(self, most: int = sys.maxsize) -> list[Message]:
        buffer, at = self._received, 0
        messages: list[Message] = []
        while len(buffer) - at >= _HEAD.size and len(messages) < most:
            size, kind = _HEAD.unpack_from(buffer, at)
            end = at + _HEAD.size + size
            if end > len(buffer):
                break
            messages.append(Message(Kind(kind), bytes(memoryview(buffer)[at + _HEAD.size : end])))
            at = end
        if at:
            del buffer[:at]
        return messages

    def _send(self) -> None:
        while not self._is_broken and (self._begun is not None or self._waiting):
            if self._begun is None:
                following = self._waiting.popleft()
                self._waiting_bytes -= len(following.data)
                self._begun = following.data
            try:
                sent = self.socket.send(self._begun)
            except (BlockingIOError, InterruptedError):
                return
            except OSError:
                self.is_ended = self._is_broken = True
                return
            self._begun = self._begun[sent:] if sent < len(self._begun) else None

    def _drop(self) -> list[bytes]:
        """Drop attitudes that nobody has taken for so long, and of too much the oldest."""
        since_s = time.monotonic() - STALE_S
        is_full = self._waiting_bytes > MOST_WAITING_BYTES
        if not is_full and self._waiting[0].since_s >= since_s:
            return []
        dropped: list[bytes] = []
        kept: deque[_Waiting] = deque()
        for each in self._waiting:
            is_stale = each.kind is Kind.ATTITUDES and each.since_s < since_s
            is_old = is_full and self._waiting_bytes > MOST_WAITING_BYTES // 2
            if is_stale or (is_old and each.kind <= Kind.LAST_DROPPABLE):
                self._waiting_bytes -= len(each.data)
                dropped.append(bytes(each.data[_HEAD.size :]))
            else:
                kept.append(each)
        self._waiting = kept
        self.dropped += len(dropped)
        return dropped
