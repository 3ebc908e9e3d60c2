"""The frames that a worker is handed, as the source of its loop."""

import pickle
import time
from collections.abc import Callable

from drivers.events import Event
from drivers.mavlink.backlog import Backlog, waiting_clock_s
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.frame_batch import unpack_frames
from drivers.mavlink.stream_request import StreamRequest
from drivers.mavlink.usual_frames import Readings, events_of
from service.workers.connection import Connection, Kind, Message
from service.workers.job import Job


class HandedFrames:
    """A live source without a thread: what has come is decoded when the loop asks for it.

    ``on_message`` gets what is not about frames. After each look it rests for the job's
    ``gather_s``, never beyond the time that the loop gives it: to wake up costs as much as some
    samples, and frames have the time of their arrival with them. It is finished when the service
    has closed the connection, or is gone.
    """

    lost = 0  # the service counts what the system and the connection had no room for

    def __init__(
        self,
        connection: Connection,
        on_message: Callable[[Message], None],
        job: Job,
    ) -> None:
        self._connection = connection
        self._on_message = on_message
        self._decoder = MavlinkDecoder(references=job.references)
        rate_hz = job.request_rate_hz
        self._request = None if rate_hz is None else StreamRequest(rate_hz)
        self._backlog = Backlog()
        self._gather_s = job.gather_s
        self._has_just_received = False

    def is_finished(self) -> bool:
        """Whether nothing can come any more."""
        return self._connection.is_ended and not self._backlog

    @property
    def dropped(self) -> int:
        """Frames thrown away because there were too many."""
        return self._backlog.dropped

    @property
    def shed(self) -> int:
        """Samples left out so far, since newer ones were there already."""
        return self._backlog.shed

    def drain(self, timeout_s: float) -> list[Event]:
        """The events of :meth:`drain_readings`."""
        return events_of(self.drain_readings(timeout_s))

    def drain_readings(self, timeout_s: float) -> list[Event | Readings]:
        """What some of what has come says, after waiting at most ``timeout_s`` for the first."""
        wait_s = 0.0 if self._backlog else timeout_s
        if self._has_just_received and wait_s > 0.0:
            rest_s = min(self._gather_s, wait_s)
            time.sleep(rest_s)
            wait_s -= rest_s
        self._has_just_received = self._receive()
        if not self._has_just_received and wait_s > 0.0:
            self._connection.wait(wait_s)
            self._has_just_received = self._receive()
        found = self._decoder.readings_of(self._backlog.take())
        found += self._backlog.take_shed(time.time_ns() // 1000)
        if self._request is not None:
            found[:] = events = events_of(found)
            outgoing, notices = self._request.take(events, time.time_ns() // 1000)
            if outgoing:
                self._connection.put(Kind.OUTGOING, pickle.dumps(outgoing))
            found += notices
        return found

    def _receive(self) -> bool:
        """Take what is there; True if there was something."""
        messages, now_s = self._connection.receive(), time.monotonic()
        for message in messages:
            if message.kind is Kind.FRAMES:
                self._backlog.add(unpack_frames(message.body), waiting_clock_s())
            else:
                self._on_message(message)
        self._backlog.note_look(now_s)
        return bool(messages)
