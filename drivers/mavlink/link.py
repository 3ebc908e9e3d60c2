"""A live MAVLink link, read by whoever drains it.

Listen-only, with two exceptions that a person asks for: ``request_rate_hz``
sends requests and heartbeats, and ``udpout`` sends heartbeats, since nobody
can answer an address that never says a word. Both come from component 191, an
onboard computer; never from a ground station.
"""

import logging
import time
from collections import OrderedDict, deque
from collections.abc import Iterator
from typing import Self

from drivers.closing import Closing
from drivers.endpoint import Endpoint
from drivers.events import Event, LinkDown, LinkUp, Malformed, Notice, VehicleId
from drivers.mavlink.background_recorder import BackgroundRecorder
from drivers.mavlink.backlog import MOST_WAITING, Arrived, Backlog, waiting_clock_s
from drivers.mavlink.claims import Claims
from drivers.mavlink.constants import (
    MAV_AUTOPILOT_INVALID,
    MAV_COMP_ID_ONBOARD_COMPUTER,
    MAV_TYPE_ONBOARD_CONTROLLER,
)
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.error_summary import ErrorSummary
from drivers.mavlink.framing import Frame, FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.mavlink.hearing import Hearing
from drivers.mavlink.opening import Opening
from drivers.mavlink.recorder import Recorder
from drivers.mavlink.scanning import Scanner, frame_of
from drivers.mavlink.sequences import SequenceWatch
from drivers.mavlink.stream_request import Outgoing, StreamRequest
from drivers.mavlink.taker import FrameTaker
from drivers.mavlink.transports.open import open_transport
from drivers.mavlink.transports.sockets import SOCKET_BUFFER_BYTES
from drivers.mavlink.transports.transport import LinkError, Packet
from drivers.mavlink.usual_frames import Readings, events_of
from estimator.compilation.compiled import is_compiled_code
from estimator.compilation.interpreted import is_interpreting
from estimator.errors import InputError

MOST_UNSENT_FRAMES = 64  # requests wait here for the reader; new ones replace the oldest
MOST_READERS = 512  # half-read frames of that many senders; the one silent for longest goes
ITERATION_S = 0.1
# After each look the link rests, and what comes meanwhile is handled at one go: to wake up costs
# as much as several samples, and hundreds of vehicles would do so at each of theirs.
GATHER_S = 0.001
# Where the system notes when each datagram came, nothing is lost by letting them wait until shortly
# before whoever drains wants to go on: so long before, or as long as the last ones have taken.
LEAD_S = 0.002
LONGEST_REST_S = 0.02
CLOSE_S = 0.5
# back-off between attempts; a vehicle that returns is read again within 1 s
FIRST_RETRY_S = 0.1
LONGEST_RETRY_S = 1.0
HEARTBEAT_S = 1.0
LOSS_TOLD_S = 60.0

_logger = logging.getLogger(__name__)


class MavlinkLink(Closing):
    """A socket or serial endpoint as a source of events.

    Entering the context opens the endpoint. ``recorder`` gets every readable
    frame that is let in; it stays the caller's to close. ``policy`` says
    what is let in, ``key`` signs what we send, and without ``references`` attitudes
    of others are not decoded. A ``taker`` gets the frames in the decoder's place.

    Everything is done by the thread that drains. A thread for reading alone would have to wait
    for Python's lock at each datagram, half a millisecond where the other thread has much to do.

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
        most_waiting: int = MOST_WAITING,
        *,
        policy: Policy = Policy(),  # noqa: B008 - immutable
        key: bytes | None = None,
        references: bool = True,
        taker: FrameTaker | None = None,
    ) -> None:
        self._endpoint = endpoint
        self._transport = open_transport(endpoint)
        self._recorder = recorder
        self._background: BackgroundRecorder | None = None
        self._request = None if request_rate_hz is None else StreamRequest(request_rate_hz)
        self._backlog = Backlog(most_waiting)
        self._events: list[Event] = []  # to be drained next
        self._decoder = MavlinkDecoder(references=references)
        self._taker = taker
        self._scanner: Scanner | None = None
        self._gate = FrameGate(policy)
        self._key = key
        self._stamp = None if policy.signing is None else policy.signing.stamp
        self._claims = Claims()
        self._readers: OrderedDict[str, FrameReader] = OrderedDict()
        self._encoders: dict[int, FrameEncoder] = {}
        self._outgoing: deque[bytes] = deque(maxlen=MOST_UNSENT_FRAMES)
        self._errors = ErrorSummary()
        self._hearing = Hearing(endpoint)
        self._sequences = SequenceWatch()
        self._opening: Opening | None = None
        self._is_closed = False
        self._is_open = False
        self._is_up = False
        self._is_down_told = False
        self._has_data = False
        self._has_just_read = False
        self._read_s = 0.0  # when something was read last
        self._retry_s = FIRST_RETRY_S
        self._retry_due_s = 0.0
        self._announce_due_s = 0.0
        self._lost_before = 0  # by transports that are closed
        self._lost_told = 0
        self._lost_due_s = 0.0

    @property
    def dropped(self) -> int:
        """Thrown away so far: frames that nobody drained, packets of floods without an IMU."""
        return self._backlog.dropped + self._claims.refused

    @property
    def shed(self) -> int:
        """IMU samples left out so far, since newer ones were there already."""
        return self._backlog.shed

    @property
    def lost(self) -> int:
        """Datagrams that the system threw away before they could be read."""
        return self._lost_before + (self._transport.lost if self._is_open else 0)

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
        if self._recorder is not None:
            self._background = BackgroundRecorder(self._recorder)
        return self

    def close(self) -> None:
        """Release the endpoint, within half a second."""
        if self._is_closed:
            return
        self._lost_before, self._is_closed, self._is_open = self.lost, True, False
        if self._opening is not None:
            self._opening.give_up(CLOSE_S)
        else:
            self._transport.close()
        if self._background is not None:
            self._background.close()

    def drain(self, timeout_s: float) -> list[Event]:
        """The events of :meth:`drain_readings`."""
        return events_of(self.drain_readings(timeout_s))

    def drain_readings(self, timeout_s: float) -> list[Event | Readings]:
        """What some of the frames that are there say, after waiting at most ``timeout_s``.

        What waits for too long is folded: of each vehicle's streams the newest alone, and
        :class:`~drivers.events.Shed` for what is left out.
        """
        if self._is_closed:
            return []
        wait_s = 0.0 if self._backlog or self._events else max(0.0, timeout_s)
        if self._is_open:
            self._receive(wait_s)
        else:
            self._reopen(wait_s)
        now_us = _unix_us()
        found: list[Event | Readings] = [*self._events]
        self._events.clear()
        found += self._decoder.readings_of(self._backlog.take())
        found += self._backlog.take_shed(now_us)
        if self._request is not None:
            found[:] = events = events_of(found)
            outgoing, notices = self._request.take(events, now_us)
            self._queue_messages(outgoing, now_us)
            found += notices
        return found

    def __iter__(self) -> Iterator[Event]:
        """Events as they come, until the link is closed."""
        while not self._is_closed:
            yield from self.drain(ITERATION_S)

    def send(self, data: bytes) -> None:
        """Queue whole frames for every peer; they leave when somebody drains."""
        self._outgoing.append(data)

    def _receive(self, wait_s: float) -> None:
        try:
            packets = self._read(wait_s)
            self._note_state()
            now_s = time.monotonic()
            self._handle(packets, now_s)
            self._backlog.note_look(now_s)
            silence = self._hearing.silence(now_s, is_up=self._is_up, has_data=self._has_data)
            self._tell(silence, _unix_us())
            self._send_due()
            self._report_loss(now_s)
        except LinkError as error:
            self._note_loss(str(error))
        except OSError as error:  # no file descriptors left, or no memory
            self._note_loss(error.strerror or str(error))

    def _read(self, wait_s: float) -> list[Packet]:
        """What has arrived; at once, only the rest in between is taken in any case."""
        if self._has_just_read and wait_s > 0.0:
            rest_s = self._rest_s(wait_s)
            time.sleep(rest_s)
            wait_s -= rest_s
        packets = self._transport.receive(wait_s)
        self._has_just_read = bool(packets)
        if packets:
            self._read_s = time.monotonic()
        return packets

    def _rest_s(self, wait_s: float) -> float:
        """How long to let datagrams gather."""
        if not self._transport.stamps_arrivals:
            return min(GATHER_S, wait_s)
        busy_s = time.monotonic() - self._read_s
        rest_s = max(GATHER_S, wait_s - max(LEAD_S, busy_s))
        return min(rest_s, wait_s, LONGEST_REST_S)

    def _reopen(self, wait_s: float) -> None:
        """Open again, some time after the last attempt."""
        opening = self._opening
        if opening is None:
            left_s = self._retry_due_s - time.monotonic()
            if left_s > 0.0:
                time.sleep(min(left_s, wait_s))
                return
            self._retry_s = min(2 * self._retry_s, LONGEST_RETRY_S)
            opening = self._opening = Opening(self._transport)
        if not opening.is_done(wait_s):
            return
        self._opening = None
        error = opening.error
        if error is None:
            self._is_open = True
        elif isinstance(error, OSError) and not isinstance(error, LinkError):
            self._note_loss(error.strerror or str(error))
        elif isinstance(error, LinkError | InputError):
            self._note_loss(str(error))
        else:
            raise error

    def _handle(self, packets: list[Packet], now_s: float) -> None:
        """Put the good frames of ``packets`` into the backlog, and all of them on record."""
        if not packets and self._taker is None:
            return
        now_us = _unix_us()
        packets = [p for p in packets if not p.data or self._claims.admits(p.peer, now_s)]
        scanned = self._scan(packets)
        waiting: list[Arrived] = []
        for k, (peer, data, stamp_us) in enumerate(packets):
            arrival_us = stamp_us or now_us
            if not data:
                self._readers.pop(peer, None)
                self._gate.forget(peer)
                continue
            if not self._has_data:
                self._note_data()
            reader = self._reader(peer)
            rows = scanned[k] if k < len(scanned) else None
            if rows is not None and self._is_usual(rows, peer, arrival_us, reader):
                self._tell(self._hearing.bytes_read(len(data), 1, now_s), arrival_us)
                usual = [frame_of(data, row) for row in rows]
                self._credit(peer, usual, now_s)
                waiting += [Arrived(arrival_us, frame) for frame in usual]
                continue
            frames = reader.feed(data)
            self._events += self._sequences.look(peer, frames, arrival_us)
            self._tell(self._hearing.bytes_read(len(data), len(frames), now_s), arrival_us)
            frames = self._gate.let_in(frames, peer, arrival_us)
            self._credit(peer, frames, now_s)
            if self._background is not None and frames:
                self._background.write(arrival_us, [frame.data for frame in frames])
            wanted = self._decoder.wanted
            waiting += [Arrived(arrival_us, each) for each in frames if each.message_id in wanted]
            if malformed := reader.take_malformed():
                self._events.append(Malformed(arrival_us, malformed))
        if self._taker is not None:
            self._hand_over(waiting, self._taker, now_us)
        else:
            self._backlog.add(waiting, waiting_clock_s())
        self._events += self._gate.take_refused(now_us)

    def _scan(self, packets: list[Packet]) -> list[list[list[int]] | None]:
        """The rows of wanted frames of each packet that is nothing but frames; else None."""
        if is_interpreting() or not is_compiled_code():
            return []
        if self._scanner is None:
            self._scanner = Scanner(self._decoder.wanted)
        return self._scanner.scan([packet.data for packet in packets])

    def _is_usual(
        self, rows: list[list[int]], peer: str, arrival_us: int, reader: FrameReader
    ) -> bool:
        """Whether a packet's frames are let in, and nobody else wants to look at them."""
        if not rows or self._background is not None or not reader.is_between_frames:
            return False
        address = (rows[0][1], rows[0][2])
        if self._sequences.looks_at(peer, address, arrival_us):
            return False
        return self._gate.lets_in_as_before(address, peer, arrival_us)

    def _credit(self, peer: str, frames: list[Frame], now_s: float) -> None:
        """Sound frames that are let in give a peer its place."""
        if frames:
            self._claims.note(peer, frames, now_s)
            self._transport.credit(peer)

    def _tell(self, text: str | None, now_us: int) -> None:
        if text is not None:
            self._events.append(Notice(None, now_us, text))

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
        self._events.append(LinkUp(_unix_us(), str(self._endpoint)))

    def _note_data(self) -> None:
        """Only bytes show that a link works: a server may accept and close at once."""
        self._has_data, self._retry_s = True, FIRST_RETRY_S
        attempts = self._errors.clear()
        after = f" after {attempts} failed attempts" if attempts else ""
        _logger.info("%s: data arrives%s", self._endpoint, after)

    def _note_loss(self, reason: str) -> None:
        self._lost_before = self.lost
        self._retry_due_s = time.monotonic() + self._retry_s
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
        self._events.append(LinkDown(_unix_us(), str(self._endpoint), reason))

    def _report_loss(self, now_s: float) -> None:
        """Say that the system throws datagrams away, and what helps, once a minute at most."""
        lost = self.lost
        if lost == self._lost_told or now_s < self._lost_due_s:
            return
        self._lost_due_s = now_s + LOSS_TOLD_S
        count, self._lost_told = lost - self._lost_told, lost
        text = (
            f"{self._endpoint}: {count} datagrams were lost, the system had no room for them; "
            f"sysctl net.core.rmem_max={SOCKET_BUFFER_BYTES} gives it more"
        )
        self._events.append(Notice(None, _unix_us(), text))


def _unix_us() -> int:
    return time.time_ns() // 1000
