"""A live MAVLink link: one thread reads and decodes; the consumer drains.

Listen-only, with two exceptions that a person asks for: ``request_rate_hz``
sends requests and heartbeats, and ``udpout`` sends heartbeats, since nobody
can answer an address that never says a word. Both come from component 191, an
onboard computer; never from a ground station.
"""

import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Iterator
from contextlib import suppress
from itertools import groupby
from operator import itemgetter
from typing import Self

from drivers.busy import BusyShare
from drivers.closing import Closing
from drivers.endpoint import Endpoint
from drivers.events import Event, LinkDown, LinkUp, Malformed, Notice, VehicleId
from drivers.mavlink.backlog import Backlog, Stamped
from drivers.mavlink.constants import (
    MAV_AUTOPILOT_INVALID,
    MAV_COMP_ID_ONBOARD_COMPUTER,
    MAV_TYPE_ONBOARD_CONTROLLER,
)
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.error_summary import ErrorSummary
from drivers.mavlink.framing import FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.mavlink.hearing import Hearing
from drivers.mavlink.recorder import Recorder
from drivers.mavlink.stream_request import Outgoing, StreamRequest
from drivers.mavlink.taker import FrameTaker
from drivers.mavlink.thinning import Arrived, newest
from drivers.mavlink.transports.open import open_transport
from drivers.mavlink.transports.transport import LinkError
from drivers.queue import EventQueue
from estimator.errors import InputError

QUEUE_EVENTS = 50_000  # 100 s of one vehicle at 100 Hz, 1 s of 200 vehicles at 50 Hz
MOST_UNSENT_FRAMES = 64  # requests wait here for the reader; new ones replace the oldest
MOST_READERS = 64  # half-read frames of that many senders; the one silent for longest goes
RECEIVE_S = 0.1  # the reader looks this often whether it should end
# After each look the reader rests, and what comes meanwhile is handled at one go: to wake a thread
# costs as much as several samples, and hundreds of vehicles would wake it at each of theirs.
# Arrivals are stamped that much late at most; what comes after a longer pause is stamped at once.
GATHER_S = 0.001
CLOSE_S = 0.5
# back-off between attempts; a vehicle that returns is read again within 1 s
FIRST_RETRY_S = 0.1
LONGEST_RETRY_S = 1.0
HEARTBEAT_S = 1.0
DROP_LOG_S = 60.0

_logger = logging.getLogger(__name__)


class MavlinkLink(Closing):
    """A socket or serial endpoint as a source of events.

    Entering the context opens the endpoint. ``recorder`` gets every readable
    frame that is let in; it stays the caller's to close. ``dropped`` counts the
    events lost because nobody drained them (the oldest go first). ``policy`` says
    what is let in, ``key`` signs what we send, and without ``references`` attitudes
    of others are not decoded. A ``taker`` gets the frames in the decoder's place.

    Raises:
        InputError: on entering, when the port is taken, the device missing or
            the host unknown; from the constructor, when the endpoint is no
            link or the requested rate is not positive.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        recorder: Recorder | None = None,
        request_rate_hz: float | None = None,
        queue_events: int = QUEUE_EVENTS,
        *,
        policy: Policy = Policy(),  # noqa: B008 - immutable
        key: bytes | None = None,
        references: bool = True,
        taker: FrameTaker | None = None,
    ) -> None:
        self._endpoint = endpoint
        self._transport = open_transport(endpoint)
        self._recorder = recorder
        self._request = None if request_rate_hz is None else StreamRequest(request_rate_hz)
        self._queue = EventQueue(queue_events)
        self._decoder = MavlinkDecoder(references=references)
        self._taker = taker
        self._gate = FrameGate(policy)
        self._key = key
        self._stamp = None if policy.signing is None else policy.signing.stamp
        self._readers: OrderedDict[str, FrameReader] = OrderedDict()
        self._encoders: dict[int, FrameEncoder] = {}
        self._outgoing: deque[bytes] = deque(maxlen=MOST_UNSENT_FRAMES)
        self._errors = ErrorSummary()
        self._hearing = Hearing(endpoint)
        self._busy = BusyShare()
        self._backlog = Backlog()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._is_open = False
        self._is_up = False
        self._is_down_told = False
        self._has_data = False
        self._retry_s = FIRST_RETRY_S
        self._announce_due_s = 0.0
        self._drops_told = 0
        self._drops_due_s = 0.0

    @property
    def dropped(self) -> int:
        """Events lost so far because the queue was full."""
        return self._queue.dropped

    @property
    def address(self) -> str:
        """The address in use (with the real port, where 0 was bound)."""
        return self._transport.address

    def __enter__(self) -> Self:
        try:
            self._transport.open()
            self._is_open = True
        except LinkError as error:
            self._note_loss(str(error))
        except InputError:
            self._transport.close()
            raise
        self._thread = threading.Thread(target=self._run, name="mavlink-link", daemon=True)
        self._thread.start()
        return self

    def close(self) -> None:
        """End the thread and release the endpoint, within half a second."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(CLOSE_S)

    def drain(self, timeout_s: float) -> list[Event]:
        """All events that are there, after waiting at most ``timeout_s`` for the first."""
        return self._queue.drain(timeout_s)

    @property
    def busy(self) -> float:
        """The share of its time that the reader works."""
        return self._busy.share

    def spare(self, interval_s: float) -> None:
        """Look at what has arrived only once in ``interval_s``, and then at the newest alone.

        Of each vehicle's streams, that is. What is left out comes as :class:`~drivers.events.Shed`.
        0 looks at everything at once again.
        """
        self._backlog.interval_s = interval_s

    def __iter__(self) -> Iterator[Event]:
        """Events as they come, until the link is closed."""
        while not self._queue.closed:
            yield from self._queue.drain(RECEIVE_S)
        yield from self._queue.drain(0.0)

    def send(self, data: bytes) -> None:
        """Queue whole frames for every peer; they leave within 0.1 s, or with the next packet."""
        self._outgoing.append(data)

    # What follows runs in the reader thread

    def _run(self) -> None:
        failure: BaseException | None = None
        try:
            while not self._stop.is_set():
                if self._is_open:
                    self._receive()
                else:
                    self._reopen()
        except BaseException as error:
            failure = error  # before anything else can fail, such as to tell it
            with suppress(Exception):
                _logger.exception("the reader of %s failed", self._endpoint)
        finally:
            self._queue.close(failure)
            self._transport.close()

    def _receive(self) -> None:
        try:
            self._busy.rest()
            packets = self._transport.receive(RECEIVE_S)
            self._busy.work()
            self._note_state()
            now_us = _unix_us()
            self._handle(self._backlog.take(packets, now_us), now_us)
            self._tell(
                self._hearing.silence(time.monotonic(), is_up=self._is_up, has_data=self._has_data),
                now_us,
            )
            self._send_due()
            if packets:
                self._busy.rest()
                time.sleep(GATHER_S)
                self._busy.work()
        except LinkError as error:
            self._note_loss(str(error))
        except OSError as error:  # no file descriptors left, or no memory
            self._note_loss(error.strerror or str(error))
        self._report_drops()

    def _reopen(self) -> None:
        if self._stop.wait(self._retry_s):
            return
        self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)
        try:
            self._transport.open()
            self._is_open = True
        except (LinkError, InputError) as error:
            self._note_loss(str(error))
        except OSError as error:
            self._note_loss(error.strerror or str(error))

    def _handle(self, packets: list[Stamped], now_us: int) -> None:
        events: list[Event] = []
        arrived: list[Arrived] = []
        for arrival_us, packet in packets:
            if not packet.data:
                self._readers.pop(packet.peer, None)
                self._gate.forget(packet.peer)
                continue
            if not self._has_data:
                self._note_data()
            reader = self._reader(packet.peer)
            frames = reader.feed(packet.data)
            noise = self._hearing.bytes_read(len(packet.data), len(frames), time.monotonic())
            self._tell(noise, arrival_us)
            arrived += [
                Arrived(arrival_us, frame)
                for frame in frames
                if self._gate.lets_in(frame, packet.peer, arrival_us)
            ]
            if malformed := reader.take_malformed():
                events.append(Malformed(arrival_us, malformed))
        self._record(arrived)
        if self._backlog.interval_s > 0.0:
            arrived, shed = newest(arrived)
            events += shed
        if self._taker is not None:
            self._hand_over(arrived, self._taker, now_us)
        else:
            for arrival_us, frame in arrived:
                events += self._decoder.events(frame, arrival_us)
        events += self._gate.take_refused(now_us)
        if self._request is not None:
            events += self._requests(self._request, events, now_us)
        if events:
            self._queue.put(events)

    def _tell(self, text: str | None, now_us: int) -> None:
        if text is not None:
            self._queue.put([Notice(None, now_us, text)])

    def _record(self, arrived: list[Arrived]) -> None:
        """Record everything that was let in, also what is left out afterwards."""
        if self._recorder is not None:
            for arrival_us, each in groupby(arrived, key=itemgetter(0)):
                self._recorder.write(arrival_us, [one.frame.data for one in each])

    def _requests(self, request: StreamRequest, events: list[Event], now_us: int) -> list[Notice]:
        out = request.tick(now_us)
        for event in events:
            out += request.handle(event, now_us)
        self._queue_messages([each for each in out if isinstance(each, Outgoing)], now_us)
        return [each for each in out if isinstance(each, Notice)]

    def _hand_over(self, arrived: list[Arrived], taker: FrameTaker, now_us: int) -> None:
        """Give the frames away; what has to be sent because of them comes back."""
        taker.take(arrived)
        self._queue_messages(taker.outgoing(), now_us)

    def _queue_messages(self, messages: list[Outgoing], now_us: int) -> None:
        for each in messages:
            encoder = self._encoder(each.system_id)
            self._outgoing.append(encoder.frame(each.message, now_us))

    def _send_due(self) -> None:
        now_s = time.monotonic()
        if self._endpoint.kind == "udpout" and now_s >= self._announce_due_s:
            self._announce_due_s = now_s + HEARTBEAT_S
            message = heartbeat(MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID)
            self._outgoing.append(self._encoder(self._own_system()).frame(message, _unix_us()))
        while self._outgoing:
            self._transport.send(self._outgoing.popleft())

    def _own_system(self) -> int:
        """The system whose onboard computer we are: the first one asked, else number 1."""
        return next(iter(self._encoders), 1)

    def _encoder(self, system_id: int) -> FrameEncoder:
        if system_id not in self._encoders:
            sender = VehicleId(system_id, MAV_COMP_ID_ONBOARD_COMPUTER)
            self._encoders[system_id] = FrameEncoder(sender, self._key, stamp=self._stamp)
        return self._encoders[system_id]

    def _reader(self, peer: str) -> FrameReader:
        if peer not in self._readers:
            self._readers[peer] = FrameReader()
            if len(self._readers) > MOST_READERS:
                self._readers.popitem(last=False)
        self._readers.move_to_end(peer)
        return self._readers[peer]

    def _note_state(self) -> None:
        """Tell when the transport began or ceased to be connected."""
        if self._transport.connected == self._is_up:
            return
        if self._is_up:
            self._tell_down("the last client has left")
            return
        self._is_up, self._is_down_told = True, False
        self._queue.put([LinkUp(_unix_us(), str(self._endpoint))])

    def _note_data(self) -> None:
        """Only bytes show that a link works: a server may accept and close at once."""
        self._has_data, self._retry_s = True, FIRST_RETRY_S
        attempts = self._errors.clear()
        after = f" after {attempts} failed attempts" if attempts else ""
        _logger.info("%s: data arrives%s", self._endpoint, after)

    def _note_loss(self, reason: str) -> None:
        self._transport.close()
        self._readers.clear()
        self._gate.forget()
        self._is_open = self._has_data = False
        line = self._errors.line(reason, time.monotonic())
        if line is not None:
            _logger.warning("%s: %s; trying again", self._endpoint, line)
        if self._is_up or not self._is_down_told:
            self._tell_down(reason)

    def _tell_down(self, reason: str) -> None:
        self._is_up, self._is_down_told = False, True
        self._queue.put([LinkDown(_unix_us(), str(self._endpoint), reason)])

    def _report_drops(self) -> None:
        dropped, now_s = self._queue.dropped, time.monotonic()
        if dropped > self._drops_told and now_s >= self._drops_due_s:
            _logger.warning("%s: %d events dropped: the queue is full", self._endpoint, dropped)
            self._drops_told, self._drops_due_s = dropped, now_s + DROP_LOG_S


def _unix_us() -> int:
    return time.time_ns() // 1000
