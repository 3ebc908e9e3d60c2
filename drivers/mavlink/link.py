"""A live MAVLink link: from the bytes of an endpoint to events.

A frame goes one way: transport, framing, gate, recorder, queue, decoder. The link only listens,
but for what :mod:`drivers.mavlink.outgoing` sends.
"""

import time
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Self

from drivers.endpoint import Endpoint
from drivers.events import Event, Malformed, Shed, VehicleId
from drivers.mavlink.connection import Connection, RateLimits
from drivers.mavlink.constants import AUTOPILOT_VERSION_ID, HEARTBEAT_ID
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import Frame, FrameReader
from drivers.mavlink.gate import FrameGate, Policy
from drivers.mavlink.messages import IMU_MESSAGES, MESSAGES, imu_number, imu_stream_name
from drivers.mavlink.outgoing import Outbound
from drivers.mavlink.recorder import Recorder
from drivers.mavlink.transports.transport import Packet
from drivers.resources import SLOTS, Closing, run_in_thread

MOST_READERS = SLOTS  # half-read frames of that many senders; the one silent for longest goes
# So many frames are decoded at one go, some 1 ms, before the caller can do something else.
MOST_AT_ONCE = 64
# Looks at the endpoint that find something are this far apart at least: to wake up costs as much
# as several samples, and hundreds of vehicles would wake it at each of theirs.
REST_S = 0.002
BUSY_REST_S = 0.02  # the same, while frames wait to be decoded: reading more would delay them
AHEAD_S = 0.02  # between two looks before anybody drains
MOST_WAITING = 4096  # frames: 0.4 s of 200 vehicles at 50 Hz
WHO_IS_THERE = frozenset({HEARTBEAT_ID, AUTOPILOT_VERSION_ID})
REPORT_EVERY_US = 250_000  # how often what was left out is reported

Arrived = tuple[int, Frame]  # a frame behind its arrival (host's Unix time, us)


class FrameQueue:
    """Recorded frames that wait to be decoded, in the order of their arrival.

    Only when it is full is anything left out: of each sender's streams (one message of one IMU)
    the newest frame stays, in its place, and older ones go. What is sent only once (a parameter,
    an answer) stays. A newer sample of a vehicle is worth more than an older one.
    ``dropped`` counts frames of no stream that found no room, ``shed`` IMU samples left out.
    """

    def __init__(self, most_waiting: int) -> None:
        self.dropped = self.shed = 0
        self._most_waiting = most_waiting
        self._frames: deque[Arrived] = deque()
        self._unreported: Counter[tuple[VehicleId, str]] = Counter()
        self._reported_us = 0

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, arrival_us: int, frames: Iterable[Frame]) -> None:
        """Put frames at the end."""
        self._frames.extend([(arrival_us, frame) for frame in frames])
        if len(self._frames) > self._most_waiting:
            self._keep_newest()

    def take(self, most: int) -> list[Arrived]:
        """The next frames, the oldest first, at most so many."""
        frames = self._frames
        return [frames.popleft() for _ in range(min(most, len(frames)))]

    def take_shed(self, now_us: int) -> list[Shed]:
        """Samples that were left out, if it is time to report them."""
        if not self._unreported or 0 <= now_us - self._reported_us < REPORT_EVERY_US:
            return []
        self._reported_us = now_us
        shed = [
            Shed(vehicle, now_us, message, samples)
            for (vehicle, message), samples in self._unreported.items()
        ]
        self._unreported.clear()
        return shed

    def _keep_newest(self) -> None:
        """Leave out all but the newest frame of each stream; of what is in no stream the oldest."""
        seen: set[tuple[VehicleId, int, int]] = set()
        kept: deque[Arrived] = deque()
        for arrived in reversed(self._frames):
            _, frame = arrived
            kind, imu = frame.message_id, IMU_MESSAGES.get(frame.message_id)
            if imu is not None or kind in MESSAGES or kind in WHO_IS_THERE:
                vehicle = VehicleId(frame.system_id, frame.component_id)
                number = 0 if imu is None else imu_number(frame)
                if (vehicle, kind, number) in seen:
                    if imu is not None:
                        self._unreported[vehicle, imu_stream_name(imu.name, number)] += 1
                        self.shed += 1
                    continue
                seen.add((vehicle, kind, number))
            kept.appendleft(arrived)
        while len(kept) > self._most_waiting:
            kept.popleft()
            self.dropped += 1
        self._frames = kept


class MavlinkLink(Closing):
    """A socket or serial endpoint as a source of events.

    Entering the context opens the endpoint. ``recorder`` gets every readable frame that is let in;
    it stays the caller's to close. ``policy`` is what is let in, and what signs what we send;
    without ``references`` attitudes of others are not decoded. Everything is done by the thread
    that drains; until it does so first, another one reads and records what comes.

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
        *,
        policy: Policy = Policy(),  # noqa: B008 - immutable
        references: bool = True,
    ) -> None:
        self._connection = Connection(endpoint, self._forget_peers)
        self._recorder = recorder
        self._limits = RateLimits()
        self._readers: OrderedDict[str, FrameReader] = OrderedDict()
        self._gate = FrameGate(policy)
        self._queue = FrameQueue(MOST_WAITING)
        self._decoder = MavlinkDecoder(references=references)
        self._outbound = Outbound(endpoint, request_rate_hz, policy)
        self._events: list[Event] = []  # to be drained next
        self._malformed = 0  # the same, of unreadable frames
        self._look_s = 0.0  # when all that was there had been read
        self._found_some = False  # at the last look
        self._is_closed = False
        self._ahead: Future[None] | None = None
        self._is_drained = False

    @property
    def dropped(self) -> int:
        """Thrown away so far: frames that found no room, packets of floods without an IMU."""
        return self._queue.dropped + self._limits.refused

    @property
    def shed(self) -> int:
        """IMU samples left out so far, since newer ones were there already."""
        return self._queue.shed

    @property
    def lost(self) -> int:
        """Datagrams that the system threw away, as of the last look for them."""
        return self._connection.lost

    def __enter__(self) -> Self:
        self._connection.open()
        self._ahead = run_in_thread(self._read_ahead, "mavlink-read-ahead")
        return self

    def close(self) -> None:
        """Release the endpoint, within half a second; what it still holds is recorded."""
        if self._is_closed:
            return
        self._is_closed = True
        self._stop_ahead()
        if self._connection.is_open:
            self._receive(0.0)
        self._connection.close()

    def follow(self, imu_in_use: Callable[[VehicleId], str | None]) -> None:
        """Skip a vehicle's other IMU messages while the one that is used of it comes."""
        self._decoder.imu_in_use = imu_in_use

    def drain(self, timeout_s: float) -> list[Event]:
        """Events of what has arrived, after waiting at most ``timeout_s`` for the first."""
        if self._is_closed:
            return []
        self._stop_ahead()
        is_idle = not len(self._queue)
        if is_idle or time.monotonic() - self._look_s >= BUSY_REST_S:
            self._receive(timeout_s if is_idle and not self._events else 0.0)
        now_us = time.time_ns() // 1000
        events = [*self._connection.take_events(), *self._events]
        self._events.clear()
        if self._malformed:
            events.append(Malformed(now_us, self._malformed))
            self._malformed = 0
        for arrival_us, frame in self._queue.take(MOST_AT_ONCE):
            events += self._decoder.events(frame, arrival_us)
        events += self._queue.take_shed(now_us)
        events += self._outbound.react(events, now_us)
        for frame_bytes in self._outbound.take_frames(now_us):
            self._connection.send(frame_bytes)
        return events

    def _read_ahead(self) -> None:
        """Look again and again, until somebody drains: kernels may be compiled first."""
        while not self._is_drained:
            self._receive(AHEAD_S)

    def _stop_ahead(self) -> None:
        """Wait for the end of the last look; raises what went wrong in one."""
        self._is_drained = True
        if self._ahead is not None:
            ahead, self._ahead = self._ahead, None
            ahead.result()

    def _receive(self, wait_s: float) -> None:
        """Take in all that has arrived: frames into the recording and into the queue."""
        since_s = time.monotonic() - self._look_s
        if self._found_some and since_s < REST_S:
            time.sleep(max(0.0, min(REST_S - since_s, wait_s)))
        packets = self._connection.receive(wait_s)
        self._found_some, self._look_s = bool(packets), time.monotonic()
        frames = sum([self._take(packet) for packet in packets])
        if packets:
            self._connection.note_read(sum([len(packet.data) for packet in packets]), frames)
            now_us = time.time_ns() // 1000
            self._gate.keep(now_us)
            self._events += self._gate.take_refused(now_us)

    def _take(self, packet: Packet) -> int:
        """Take in what one peer has sent; returns how many frames were readable."""
        peer, data, arrival_us = packet
        if not data:  # it has left
            self._readers.pop(peer, None)
            self._gate.forget(peer)
            return 0
        if not self._limits.admits(peer, len(data), arrival_us * 1e-6):
            return 0
        reader = self._readers.pop(peer, None) or FrameReader()
        self._readers[peer] = reader  # behind all others
        if len(self._readers) > MOST_READERS:
            self._readers.popitem(last=False)
        frames = reader.feed(data)
        self._malformed += reader.take_malformed()
        let_in = self._gate.let_in(frames, peer, arrival_us)
        if self._recorder is not None:
            self._recorder.write(arrival_us, [frame.data for frame in let_in])
        if any(frame.message_id in IMU_MESSAGES for frame in let_in):  # it keeps its slot
            self._limits.note_imu(peer, arrival_us * 1e-6)
            self._connection.credit(peer)
        wanted = self._decoder.wanted
        self._queue.add(arrival_us, [frame for frame in let_in if frame.message_id in wanted])
        return len(frames)

    def _forget_peers(self) -> None:
        self._readers.clear()
        self._gate.forget()
