"""Hands the frames of a link out to the workers."""

import threading
from collections import defaultdict, deque
from collections.abc import Sequence
from typing import NamedTuple

from drivers.mavlink.ardupilot import ACC_FILTER, COMPASS_OFFSETS, GYRO_FILTER
from drivers.mavlink.backlog import Arrived
from drivers.mavlink.constants import AUTOPILOT_VERSION_ID, HEARTBEAT_ID, PARAM_VALUE_ID
from drivers.mavlink.frame_batch import frame_count, pack_frames
from drivers.mavlink.framing import Frame
from drivers.mavlink.stream_request import Outgoing
from service.workers.assignment import Assignment
from service.workers.connection import Connection, Kind

WINDOW_US = 1_000_000
NAME_BEGIN, NAME_END = 8, 24  # of param_id in PARAM_VALUE's payload
KEPT_NAMES = frozenset(name.encode() for name in (*COMPASS_OFFSETS, GYRO_FILTER, ACC_FILTER))
# COMPASS_OFS of a few components, their HEARTBEATs and AUTOPILOT_VERSIONs
MOST_KEPT = 32


class _Key(NamedTuple):
    component_id: int
    message_id: int
    name: bytes


class Handout:
    """A :class:`~drivers.mavlink.taker.FrameTaker`; the reader's thread takes, others may ask.

    ``wanted`` holds the numbers of the messages that a worker's decoder makes something of.
    What a vehicle says but once (its compass offsets, what it is) is kept for a worker that has to
    go on for another.
    """

    def __init__(self, workers: int, wanted: frozenset[int]) -> None:
        self.handed = 0  # frames so far
        self.dropped = 0  # frames that a worker did not take in time
        self._wanted = wanted
        self._lock = threading.Lock()
        self._assignment = Assignment(workers)
        self._connections: list[Connection | None] = [None] * workers
        self._outgoing: deque[Outgoing] = deque()
        self._said_once: defaultdict[int, dict[_Key, Arrived]] = defaultdict(dict)
        self._window_us: int | None = None

    def take(self, arrived: list[Arrived]) -> None:
        """Hand each frame to the worker of its system."""
        batches: defaultdict[int, list[Arrived]] = defaultdict(list)
        worker_of = self._assignment.worker
        with self._lock:
            for each in arrived:
                frame = each.frame
                if frame.message_id not in self._wanted:
                    continue
                if frame.message_id in _SAID_ONCE:
                    self._keep(each)
                batches[worker_of(frame.system_id)].append(each)
            self.handed += len(arrived)
            for worker, batch in batches.items():
                self._send(worker, batch)
            if arrived:
                self._note_time(arrived[-1].arrival_us)

    def outgoing(self) -> list[Outgoing]:
        """The messages of workers for vehicles since the last call."""
        return [self._outgoing.popleft() for _ in range(len(self._outgoing))]

    def send(self, messages: Sequence[Outgoing]) -> None:
        """Have messages sent at the reader's next look, 0.1 s from now at the latest."""
        self._outgoing.extend(messages)

    def connect(self, worker: int, connection: Connection, job: bytes) -> None:
        """Send a worker's frames over another connection from now on.

        The ``job`` goes first, then what its vehicles have said but once.
        """
        with self._lock:
            connection.put(Kind.JOB, job)
            for system in self._assignment.systems(worker):
                if said := list(self._said_once[system].values()):
                    connection.put(Kind.FRAMES, pack_frames(said))
            self._connections[worker] = connection

    def systems(self, worker: int) -> list[int]:
        """The systems that a worker has."""
        with self._lock:
            return self._assignment.systems(worker)

    def worker(self, system_id: int) -> int | None:
        """The worker that has a system; None if the system has not been heard."""
        with self._lock:
            return self._assignment.known(system_id)

    def _send(self, worker: int, batch: list[Arrived]) -> None:
        connection = self._connections[worker]
        if connection is None:
            self.dropped += len(batch)
            return
        for body in connection.put(Kind.FRAMES, pack_frames(batch)):
            self.dropped += frame_count(body)

    def _keep(self, arrived: Arrived) -> None:
        frame = arrived.frame
        name = b""
        if frame.message_id == PARAM_VALUE_ID:
            name = _name(frame)
            if name not in KEPT_NAMES:
                return
        kept = self._said_once[frame.system_id]
        key = _Key(frame.component_id, frame.message_id, name)
        if key in kept or len(kept) < MOST_KEPT:
            kept[key] = arrived

    def _note_time(self, now_us: int) -> None:
        if self._window_us is None or not 0 <= now_us - self._window_us < WINDOW_US:
            self._window_us = now_us
            self._assignment.close_window()


_SAID_ONCE = frozenset({HEARTBEAT_ID, AUTOPILOT_VERSION_ID, PARAM_VALUE_ID})


def _name(frame: Frame) -> bytes:
    """The parameter's name in a PARAM_VALUE; zeros at the payload's end are not sent."""
    payload = frame.data[frame.payload_at : frame.payload_end]
    return payload[NAME_BEGIN:NAME_END].split(b"\0", 1)[0]
