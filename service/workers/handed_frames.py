"""The frames that a worker is handed, as the source of its loop."""

import pickle
import time
from collections.abc import Callable

from drivers.events import Event
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.frame_batch import unpack_frames
from drivers.mavlink.stream_request import Outgoing, StreamRequest
from drivers.mavlink.thinning import Arrived, newest
from service.workers.connection import Connection, Kind, Message


class HandedFrames:
    """A live source without a thread: what has come is decoded when the loop asks for it.

    ``on_message`` gets what is not about frames. It is finished when the service has closed the
    connection, or is gone.
    """

    dropped = 0  # the service counts what the connection has no room for
    busy = 0.0

    def __init__(
        self,
        connection: Connection,
        on_message: Callable[[Message], None],
        *,
        request_rate_hz: float | None,
        references: bool,
    ) -> None:
        self._connection = connection
        self._on_message = on_message
        self._decoder = MavlinkDecoder(references=references)
        self._request = None if request_rate_hz is None else StreamRequest(request_rate_hz)
        self._interval_s = 0.0
        self._due_s = 0.0
        self._held: list[Arrived] = []

    def is_finished(self) -> bool:
        """Whether nothing can come any more."""
        return self._connection.is_ended

    def spare(self, interval_s: float) -> None:
        """Look at what has come only once in ``interval_s``, at the newest alone; 0 at all."""
        self._interval_s = interval_s

    def drain(self, timeout_s: float) -> list[Event]:
        """The events of what has come, after waiting at most ``timeout_s`` for the first."""
        if not self._receive():
            self._connection.wait(timeout_s)
            self._receive()
        events: list[Event] = []
        if self._interval_s > 0.0:
            if time.monotonic() < self._due_s:
                return []
            self._due_s = time.monotonic() + self._interval_s
            self._held, shed = newest(self._held)
            events += shed
        held, self._held = self._held, []
        for arrival_us, frame in held:
            events += self._decoder.events(frame, arrival_us)
        if self._request is not None:
            events += self._requests(self._request, events)
        return events

    def _receive(self) -> bool:
        """Take what is there; True if there was something."""
        messages = self._connection.receive()
        for message in messages:
            if message.kind is Kind.FRAMES:
                self._held += unpack_frames(message.body)
            else:
                self._on_message(message)
        return bool(messages)

    def _requests(self, request: StreamRequest, events: list[Event]) -> list[Event]:
        """What is to be told because of the events; what is to be sent goes to the service."""
        now_us = time.time_ns() // 1000
        out = request.tick(now_us)
        for event in events:
            out += request.handle(event, now_us)
        if outgoing := [each for each in out if isinstance(each, Outgoing)]:
            self._connection.put(Kind.OUTGOING, pickle.dumps(outgoing))
        return [each for each in out if not isinstance(each, Outgoing)]
