"""A live MAVLink link, read by whoever drains it.

Listen-only, with two exceptions that a person asks for: ``request_rate_hz``
sends requests and heartbeats, and ``udpout`` sends heartbeats, since nobody
can answer an address that never says a word. Both come from component 191, an
onboard computer; never from a ground station.
"""

import logging
import time
from collections import OrderedDict, deque
from concurrent.futures import Future, wait
from typing import NamedTuple, Self

import numpy as np

from drivers.aside import aside
from drivers.closing import Closing
from drivers.endpoint import Endpoint
from drivers.events import Event, LinkDown, LinkUp, Malformed, Notice, VehicleId
from drivers.mavlink.background_recorder import BackgroundRecorder
from drivers.mavlink.backlog import (
    MOST_WAITING,
    PATIENCE_S,
    Arrived,
    Backlog,
    Patience,
    waiting_clock_s,
)
from drivers.mavlink.claims import Claims, cost
from drivers.mavlink.constants import (
    MAV_AUTOPILOT_INVALID,
    MAV_COMP_ID_ONBOARD_COMPUTER,
    MAV_TYPE_ONBOARD_CONTROLLER,
)
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.encoder import FrameEncoder, heartbeat
from drivers.mavlink.error_summary import ErrorSummary
from drivers.mavlink.framing import LONGEST_FRAME, Frame, FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.mavlink.hearing import Hearing
from drivers.mavlink.leases import JUDGED, PASSES, WAITS, Array, Leases
from drivers.mavlink.readings import Batch, Readings, events_of
from drivers.mavlink.recorder import Records, SharedRecorder, records_of
from drivers.mavlink.scanning import LEFT, Scanned, Scanner
from drivers.mavlink.sequences import STRETCH_US, SequenceWatch
from drivers.mavlink.stamped_frames import records_in
from drivers.mavlink.stream_request import Outgoing, StreamRequest
from drivers.mavlink.transports.datagrams import Datagrams, unix_us
from drivers.mavlink.transports.open import open_transport
from drivers.mavlink.transports.sockets import SOCKET_BUFFER_BYTES
from drivers.mavlink.transports.transport import LinkError
from drivers.mavlink.triage import newest, said_once
from drivers.mavlink.usual_kinds import NUMBER
from drivers.places import PLACES
from estimator.compilation.compiled import is_compiled_code
from estimator.compilation.interpreted import is_interpreting
from estimator.errors import InputError

MOST_UNSENT_FRAMES = 64  # requests wait here for the reader; new ones replace the oldest
MOST_READERS = PLACES  # half-read frames of that many senders; the one silent for longest goes
LEASE_MARGIN_S = 0.1  # a lease ends before the claim that it rests on
# After each look the link rests, and what comes meanwhile is handled at one go: to wake up costs
# as much as several samples, and hundreds of vehicles would do so at each of theirs.
GATHER_S = 0.001
# Where the system notes when each datagram came, nothing is lost by letting them wait until whoever
# drains wants to go on, less the time that the last ones have taken.
LONGEST_REST_S = 0.02
CLOSE_S = 0.5
# So many frames that need not wait are read at one go: 1 ms or so where Python reads few of them.
MOST_PASSING = 512
# back-off between attempts; a vehicle that returns is read again within 1 s
FIRST_RETRY_S = 0.1
LONGEST_RETRY_S = 1.0
HEARTBEAT_S = 1.0
FLOOD = 64  # packets of one sender at one look
LOST_LOOK_S = 0.25
LOSS_TOLD_S = 60.0

_logger = logging.getLogger(__name__)


class _Passed(NamedTuple):
    """Frames that are read without waiting for their turn, as a batch has them."""

    scanned: Scanned
    frames: Array


class MavlinkLink(Closing):
    """A socket or serial endpoint as a source of events.

    Entering the context opens the endpoint. ``recorder`` gets every readable
    frame that is let in; it stays the caller's to close. ``policy`` says
    what is let in, ``key`` signs what we send, and without ``references`` attitudes
    of others are not decoded.

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
        recorder: SharedRecorder | None = None,
        request_rate_hz: float | None = None,
        most_waiting: int = MOST_WAITING,
        *,
        policy: Policy = Policy(),  # noqa: B008 - immutable
        key: bytes | None = None,
        references: bool = True,
    ) -> None:
        self._endpoint = endpoint
        self._transport = open_transport(endpoint)
        self._recorder = recorder
        self._background: BackgroundRecorder | None = None
        self._records: list[Records] = []  # of packets that were judged in this look
        self._request = None if request_rate_hz is None else StreamRequest(request_rate_hz)
        self._backlog = Backlog(most_waiting)
        self._passing: _Passed | None = None  # what need not wait there
        self._patience = Patience()
        self._clock_s = waiting_clock_s()  # when something was looked for last,
        self._busy_s = 0.0  # and how long there was no time for that before
        self._events: list[Event] = []  # to be drained next
        self._decoder = MavlinkDecoder(references=references)
        self._scanner: Scanner | None = None
        self._leases = Leases()
        self._gate = FrameGate(policy, self._leases.heard_us)
        self._key = key
        self._stamp = None if policy.signing is None else policy.signing.stamp
        self._claims = Claims(is_proven=policy.signing is not None)
        self._readers: OrderedDict[str, FrameReader] = OrderedDict()
        self._encoders: dict[int, FrameEncoder] = {}
        self._outgoing: deque[bytes] = deque(maxlen=MOST_UNSENT_FRAMES)
        self._errors = ErrorSummary()
        self._hearing = Hearing(endpoint)
        self._sequences = SequenceWatch()
        self._whole = FrameReader()  # of packets that hold whole frames
        self._opening: Future[None] | None = None
        self._is_closed = False
        self._is_open = False
        self._is_up = False
        self._is_down_told = False
        self._has_data = False
        self._has_just_read = False
        self._is_awaited = False  # the next datagram, as the last was when a rest was over
        self._read_s = 0.0  # when something was read last
        self._look_s = 0.0  # when all that was there had been read
        self._retry_s = FIRST_RETRY_S
        self._retry_due_s = 0.0
        self._announce_due_s = 0.0
        self.lost = 0  # datagrams that the system threw away, as of the last look for them,
        self._lost_before = 0  # by transports that are closed
        self._lost_look_s = 0.0
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
        self._count_lost()
        self._is_closed, self._is_open = True, False
        if self._opening is not None:
            # a transport that opens later is closed at once
            self._opening.add_done_callback(lambda _: self._transport.close())
            wait([self._opening], CLOSE_S)
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
        backlog = self._backlog
        is_idle = backlog.is_at_rest and self._passing is None
        wait_s = max(0.0, timeout_s) if is_idle and not self._events else 0.0
        # what is newer is read behind what waits
        if is_idle or (self._passing is None and not self._has_turns()):
            (self._receive if self._is_open else self._reopen)(wait_s)
        now_us = unix_us()
        found: list[Event | Readings] = [*self._events]
        self._events.clear()
        if self._passing is not None:
            found += self._read_passing(self._passing)
        if self._passing is None and not backlog.is_at_rest:
            found += self._decoder.readings_of(backlog.take())
        found += backlog.take_shed(now_us)
        if self._request is not None:
            found[:] = events = events_of(found)
            outgoing, notices = self._request.take(events, now_us)
            self._queue_messages(outgoing, now_us)
            found += notices
        return found

    def _has_turns(self) -> bool:
        """Whether frames wait for their turn, but for so long that newer ones would take it."""
        return self._backlog.has_turns and time.monotonic() - self._look_s < PATIENCE_S

    def _receive(self, wait_s: float) -> None:
        try:
            come = self._read(wait_s)
            if self._transport.connected != self._is_up:
                self._note_state()
            now_s = time.monotonic()
            if self._has_just_read:
                self._read_s = now_s
                self._handle(come, now_s)
            else:
                silence = self._hearing.silence(now_s, is_up=self._is_up, has_data=self._has_data)
                self._tell(silence, unix_us())
            self._backlog.note_look(now_s)
            self._look_s = now_s
            self._send_due(now_s)
            if now_s >= self._lost_look_s:
                self._look_for_loss(now_s)
        except LinkError as error:
            self._note_loss(str(error))
        except OSError as error:  # no file descriptors left, or no memory
            self._note_loss(error.strerror or str(error))

    def _read(self, wait_s: float) -> Datagrams:
        """What has arrived; at once, only the rest in between is taken in any case."""
        begin_s, rest_s = time.monotonic(), 0.0
        self._busy_s = begin_s - self._look_s
        if self._busy_s > PATIENCE_S:  # or nothing has waited for too long by any clock
            self._busy_s = waiting_clock_s() - self._clock_s
        if wait_s > 0.0 and (self._has_just_read or self._transport.stamps_arrivals):
            rest_s = self._rest_s(wait_s, begin_s)
            if self._is_awaited:  # to wake up for the rest's end, too, costs as much again
                wait_s = rest_s + GATHER_S
            else:
                time.sleep(rest_s)
                wait_s -= rest_s
        come = self._transport.receive_many(0.0)
        waits = wait_s > 0.0 and not len(come.peers)
        if waits:
            come = self._transport.receive_many(wait_s)
        self._clock_s = waiting_clock_s()
        self._has_just_read = len(come.peers) > 0
        is_late = self._has_just_read and time.monotonic() - begin_s >= rest_s
        self._is_awaited = waits and is_late
        return come

    def _rest_s(self, wait_s: float, now_s: float) -> float:
        """How long to let datagrams gather."""
        if not self._transport.stamps_arrivals:
            return min(GATHER_S, wait_s)
        rest_s = max(GATHER_S, wait_s - (now_s - self._read_s))
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
            # to look a name up may take many seconds, and a device may be as slow
            opening = self._opening = aside(self._transport.open, "mavlink-opening")
        if not wait([opening], wait_s).done:
            return
        self._opening = None
        error = opening.exception()
        if error is None:
            self._is_open = True
        elif isinstance(error, OSError) and not isinstance(error, LinkError):
            self._note_loss(error.strerror or str(error))
        elif isinstance(error, LinkError | InputError):
            self._note_loss(str(error))
        else:
            raise error

    def _handle(self, come: Datagrams, now_s: float) -> None:
        """Have most frames read at once; put the others into the backlog, and all on record."""
        if come.number + len(come.data) // LONGEST_FRAME >= FLOOD:  # less costs no more than that
            come = self._without_floods(come, now_s)
        clock_s = self._clock_s
        scanned = whole = self._scan(come)
        held = self._held(whole) if whole is not None and self._background is not None else None
        if scanned is not None and self._is_late(now_s, clock_s):
            scanned = self._thin_out(scanned, clock_s)
            come = scanned.datagrams
        done = [JUDGED] * come.number if scanned is None else self._let_pass(scanned, now_s)
        if held is not None and self._background is not None:
            self._background.miss(int(np.count_nonzero(~held)) - done.count(JUDGED))
        waiting: list[Arrived] = []
        if done.count(PASSES) < len(done):
            waiting = self._waiting(come, done, scanned, now_s)
        if self._background is not None:
            self._record(self._background, whole, held)
        if waiting or not self._backlog.is_at_rest:
            self._backlog.add(waiting, clock_s)

    def _waiting(
        self, come: Datagrams, done: list[int], scanned: Scanned | None, now_s: float
    ) -> list[Arrived]:
        """The frames of packets that wait, and of those that are judged now."""
        waiting: list[Arrived] = []
        for k, become in enumerate(done):
            if become == JUDGED:
                waiting += self._judged(come, k, scanned, now_s)
            elif scanned is not None and become == WAITS:
                arrival_us = int(come.arrivals_us[k])
                waiting += [Arrived(arrival_us, frame) for frame in scanned.frames(k)]
        now_us = unix_us()
        self._gate.keep(now_us)
        self._events += self._gate.take_refused(now_us)
        return waiting

    def _without_floods(self, come: Datagrams, now_s: float) -> Datagrams:
        """Without what would be refused of who has sent very much since the last look."""
        costs = cost(come.ends - come.begins)
        stays = np.ones(come.number, np.bool_)
        peers, numbers = np.unique(come.peers, return_inverse=True)
        for k in (np.bincount(numbers, costs) >= FLOOD).nonzero()[0].tolist():
            own, name = (numbers == k).nonzero()[0], come.name_of(int(peers[k]))
            stays[own] = costs[own].cumsum() <= self._claims.most(name, self._look_s, now_s)
        self._claims.refused += come.number - int(np.count_nonzero(stays))
        return come.kept(stays)

    def _let_pass(self, scanned: Scanned, now_s: float) -> list[int]:
        """Have the frames of those read before all that waits who have a lease.

        Returns what becomes of each packet.
        """
        come = scanned.datagrams
        last_us = int(come.arrivals_us[-1])
        backlog, is_folded = self._backlog, self._backlog.is_folded
        waiting = set[int]() if is_folded else backlog.senders
        done, passing = self._leases.passing(scanned, waiting, backlog.has_come)
        if is_folded:
            backlog.overtake(set(scanned.senders[done == PASSES].tolist()))
        found: list[int] = done.tolist()
        if self._sequences.since_us(last_us) <= STRETCH_US:
            self._look_at(scanned, found)
        if found.count(JUDGED) < len(found):
            self._tell(self._hearing.bytes_read(len(come.data), 1, now_s), last_us)
            if not self._transport.stamps_arrivals:  # who has places, and gives them to those
                for peer in np.unique(come.peers[done != JUDGED]).tolist():
                    self._transport.credit(come.name_of(peer))
            if len(passing) >= FLOOD:
                passing = self._without_chatter(scanned, passing, now_s)
            if len(passing):
                self._passing = _Passed(scanned, passing)
        return found

    def _without_chatter(self, scanned: Scanned, passing: Array, now_s: float) -> Array:
        """Without what is too much of that of which every frame has to be read."""
        stays = np.ones(len(passing), np.bool_)
        for peer, said in said_once(scanned, passing[:, NUMBER]).items():
            name = scanned.datagrams.name_of(peer)
            stays[said[self._claims.admits_said(name, len(said), now_s) :]] = False
        return passing[stays]

    def _look_at(self, scanned: Scanned, done: list[int]) -> None:
        """Look for two senders with one address among those that need not be judged, too."""
        senders = scanned.senders.tolist()
        looked_at = self._sequences.looked_at(senders)
        if not looked_at:
            return
        for k, sender in enumerate(senders):
            if sender in looked_at and done[k] != JUDGED:
                peer, data, arrival_us = scanned.datagrams.packet(k)
                self._events += self._sequences.look(peer, self._whole.feed(data), arrival_us)

    def _judged(
        self, come: Datagrams, k: int, scanned: Scanned | None, now_s: float
    ) -> list[Arrived]:
        """The frames of a packet that are let in, of those that are decoded; all go on record."""
        peer, data, arrival_us = come.packet(k)
        if not data:
            self._readers.pop(peer, None)
            self._gate.forget(peer)
            self._leases.end()
            return []
        if not self._claims.admits(peer, len(data), self._look_s, now_s):
            return []
        if not self._has_data:
            self._note_data()
        reader = self._reader(peer)
        frames = reader.feed(data)
        self._events += self._sequences.look(peer, frames, arrival_us)
        self._tell(self._hearing.bytes_read(len(data), len(frames), now_s), arrival_us)
        let_in = self._gate.let_in(frames, peer, arrival_us)
        self._credit(peer, let_in, now_s)
        if self._background is not None:
            self._records.append(records_of(arrival_us, [frame.data for frame in let_in]))
        if malformed := reader.take_malformed():
            self._events.append(Malformed(arrival_us, malformed))
        number = int(come.peers[k])
        if not reader.is_between_frames:
            self._leases.end(number)
        elif let_in:
            self._lease(let_in[-1], peer, number, arrival_us, now_s)
        return [Arrived(arrival_us, each) for each in self._of_use(let_in, scanned, k)]

    def _held(self, scanned: Scanned) -> Array:
        """Of which packets the sender has a lease: they go on record as they are; flags."""
        done, _ = self._leases.passing(scanned, (), self._backlog.has_come)
        return done != JUDGED

    def _record(
        self, background: BackgroundRecorder, scanned: Scanned | None, held: Array | None
    ) -> None:
        """Put on record what goes there as it is, and what was judged, in the order of arrival."""
        judged, self._records = self._records, []
        if scanned is None or held is None:
            for each in judged:
                background.write(each)
            return
        arrivals_us, is_left = scanned.datagrams.arrivals_us, held
        for each in judged:
            is_earlier = is_left & (arrivals_us < each.arrival_us)
            background.write(records_in(scanned, is_earlier))
            background.write(each)
            is_left &= ~is_earlier
        background.write(records_in(scanned, is_left))

    def _lease(self, frame: Frame, peer: str, number: int, arrival_us: int, now_s: float) -> None:
        """Let a peer's frames of an address pass, if nobody would refuse or hold back the next."""
        address = frame.system_id << 8 | frame.component_id
        left_s = self._claims.left_s(peer, now_s) - LEASE_MARGIN_S
        if left_s > 0.0 and self._gate.is_open:
            self._leases.grant(address, number, peer, arrival_us, int(1e6 * left_s))

    def _is_late(self, now_s: float, clock_s: float) -> bool:
        """Whether what is there has waited for so long that some of it is to be left out."""
        of_newcomers_s = PATIENCE_S if self._backlog.has_newcomers else 0.0
        is_out = self._patience.is_out(clock_s - self._busy_s + of_newcomers_s, clock_s)
        return (is_out or self._backlog.was_stopped(now_s)) and self._gate.is_open

    def _thin_out(self, scanned: Scanned, clock_s: float) -> Scanned:
        """The packets without frames that newer ones make old, before any other look at them."""
        name_of = scanned.datagrams.name_of
        scanned, old = newest(scanned)
        self._patience.note_folded(clock_s)
        for each in old:
            if self._gate.knows(each.vehicle, name_of(each.peer)):
                self._backlog.note_shed(each.vehicle, each.stream, each.samples)
        return scanned

    def _of_use(self, frames: list[Frame], scanned: Scanned | None, packet: int) -> list[Frame]:
        """Those of a packet's frames that are decoded and that :meth:`_thin_out` did not count."""
        wanted = self._decoder.wanted
        if scanned is None or scanned.counts[packet] == LEFT:
            return [each for each in frames if each.message_id in wanted]
        left = {each.data for each in scanned.frames(packet)}
        return [each for each in frames if each.data in left]

    def _read_passing(self, passed: _Passed) -> list[Event | Readings]:
        """What some of the frames say that need not wait."""
        scanned, frames = passed
        rest = frames[MOST_PASSING:]
        self._passing = _Passed(scanned, rest) if len(rest) else None
        return self._decoder.read(
            Batch(scanned.datagrams.data, frames[:MOST_PASSING]), scanned.frame
        )

    def _scan(self, come: Datagrams) -> Scanned | None:
        """The wanted frames of packets that are nothing but frames; None if nobody looks."""
        if self._scanner is None:
            if is_interpreting() or not is_compiled_code():
                return None
            self._scanner = Scanner(self._decoder.wanted)
        return self._scanner.scan(come)

    def _credit(self, peer: str, frames: list[Frame], now_s: float) -> None:
        """An IMU's frames that are let in give a peer its place."""
        if frames:
            self._claims.note(peer, (frame.message_id for frame in frames), now_s)
            if self._claims.left_s(peer, now_s):
                self._transport.credit(peer)

    def _tell(self, text: str | None, now_us: int) -> None:
        if text is not None:
            self._events.append(Notice(None, now_us, text))

    def _queue_messages(self, messages: list[Outgoing], now_us: int) -> None:
        for each in messages:
            encoder = self._encoder(each.system_id)
            self._outgoing.append(encoder.frame(each.message, now_us))

    def _send_due(self, now_s: float) -> None:
        if self._endpoint.kind == "udpout" and now_s >= self._announce_due_s:
            self._announce_due_s = now_s + HEARTBEAT_S
            message = heartbeat(MAV_TYPE_ONBOARD_CONTROLLER, MAV_AUTOPILOT_INVALID)
            self._outgoing.append(self._encoder(self._own_system()).frame(message, unix_us()))
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
        """Tell that the transport began or ceased to be connected."""
        if self._is_up:
            self._tell_down("the last client has left")
            return
        self._is_up, self._is_down_told = True, False
        self._events.append(LinkUp(unix_us(), str(self._endpoint)))

    def _note_data(self) -> None:
        """Only bytes show that a link works: a server may accept and close at once."""
        self._has_data, self._retry_s = True, FIRST_RETRY_S
        attempts = self._errors.clear()
        after = f" after {attempts} failed attempts" if attempts else ""
        _logger.info("%s: data arrives%s", self._endpoint, after)

    def _note_loss(self, reason: str) -> None:
        self._count_lost()
        self._lost_before = self.lost
        self._retry_due_s = time.monotonic() + self._retry_s
        self._transport.close()
        self._readers.clear()
        self._gate.forget()
        self._leases.end()
        self._is_open = self._has_data = False
        line = self._errors.line(reason, time.monotonic())
        if line is not None:
            _logger.warning("%s: %s; trying again", self._endpoint, line)
        if self._is_up or not self._is_down_told:
            self._tell_down(reason)

    def _tell_down(self, reason: str) -> None:
        self._is_up, self._is_down_told = False, True
        self._events.append(LinkDown(unix_us(), str(self._endpoint), reason))

    def _count_lost(self) -> None:
        if self._is_open:
            self.lost = self._lost_before + self._transport.lost

    def _look_for_loss(self, now_s: float) -> None:
        """Say that the system throws datagrams away, and what helps, once a minute at most."""
        self._lost_look_s = now_s + LOST_LOOK_S
        self._count_lost()
        lost = self.lost
        if lost == self._lost_told or now_s < self._lost_due_s:
            return
        self._lost_due_s = now_s + LOSS_TOLD_S
        count, self._lost_told = lost - self._lost_told, lost
        text = (
            f"{self._endpoint}: {count} datagrams were lost, the system had no room for them; "
            f"sysctl net.core.rmem_max={SOCKET_BUFFER_BYTES} gives it more"
        )
        self._events.append(Notice(None, unix_us(), text))
