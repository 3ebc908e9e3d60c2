"""What a link takes when more comes than can be read: limits of senders, and one bounded queue.

A flood of heartbeats costs as much to read as samples do. So each peer without an IMU has a budget
of packets a second, and all of them together have one. A peer that sends IMU data has a larger
budget of its own, so that nobody else's flood keeps its samples out.

In the queue frames that were recorded wait to be decoded. Only when it is full is anything left
out: of each sender's streams (one message of one IMU) the newest frame stays, in its place, and
older ones go. A newer sample of a vehicle is worth more than an older one, and what is sent only
once (a parameter, an answer) stays.
"""

from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import inf

from drivers.events import Shed, VehicleId
from drivers.mavlink.constants import AUTOPILOT_VERSION_ID, HEARTBEAT_ID
from drivers.mavlink.framing import Frame
from drivers.mavlink.messages import IMU_MESSAGES, MESSAGES, imu_number, imu_stream_name

PACKETS_HZ = 200.0  # of a peer without an IMU; a ground station sends a tenth of that
ALL_PACKETS_HZ = 2000.0  # of all those together
IMU_PACKETS_HZ = 30_000.0  # of a peer with an IMU; a router may forward 200 vehicles
IMU_COUNTS_S = 5.0  # a peer counts as one with an IMU for so long after a sample
FRAME_BYTES = 64  # of a usual frame: a packet that is larger counts as several
MOST_PEERS = 1024


@dataclass(slots=True)
class _Budget:
    """A second's worth of packets, refilled as time goes by."""

    left: float
    at_s: float
    imu_s: float = -inf  # when its peer last sent IMU data

    def take(self, packets: int, rate_hz: float, now_s: float) -> bool:
        """Whether there are so many left, which are then taken; a full one is enough for any."""
        left = self.left + rate_hz * max(0.0, now_s - self.at_s)  # the clock may be set
        self.left, self.at_s = min(rate_hz, left), now_s
        packets = min(packets, int(rate_hz))
        if self.left < packets:
            return False
        self.left -= packets
        return True

    def has_imu(self, now_s: float) -> bool:
        """Whether its peer has sent IMU data lately."""
        return now_s - self.imu_s < IMU_COUNTS_S


class RateLimits:
    """Decides whether a peer's packet is read; ``refused`` counts those that are not.

    Times are those of the packets' arrival, in s: nobody is refused because this process has not
    looked for a while.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._peers: dict[str, _Budget] = {}
        self._all = _Budget(ALL_PACKETS_HZ, 0.0)

    def admits(self, peer: str, size: int, now_s: float) -> bool:
        """Whether a packet of ``size`` bytes is read that arrived at ``now_s``."""
        known = self._peers.get(peer)
        if known is None:
            if len(self._peers) >= MOST_PEERS:  # the budget of all without an IMU still holds
                self._peers = {k: p for k, p in self._peers.items() if p.has_imu(now_s)}
            known = self._peers[peer] = _Budget(PACKETS_HZ, now_s)
        packets = 1 + size // FRAME_BYTES
        if known.has_imu(now_s):
            is_admitted = known.take(packets, IMU_PACKETS_HZ, now_s)
        else:
            is_admitted = known.take(packets, PACKETS_HZ, now_s) and self._all.take(
                packets, ALL_PACKETS_HZ, now_s
            )
        self.refused += not is_admitted
        return is_admitted

    def note_imu(self, peer: str, now_s: float) -> None:
        """IMU data of ``peer`` was let in; the first of it fills its larger budget."""
        known = self._peers.get(peer)
        if known is not None:
            if not known.has_imu(now_s):
                known.left = IMU_PACKETS_HZ
            known.imu_s = now_s


MOST_WAITING = 4096  # frames: 0.4 s of 200 vehicles at 50 Hz
WHO_IS_THERE = frozenset({HEARTBEAT_ID, AUTOPILOT_VERSION_ID})
REPORT_EVERY_US = 250_000  # how often what was left out is reported


Arrived = tuple[int, Frame]  # a frame behind its arrival (host's Unix time, us)


class FrameQueue:
    """Frames in the order of their arrival; when full, the newest of each stream stays.

    ``dropped`` counts frames of no stream that found no room, ``shed`` IMU samples left out.
    """

    def __init__(self, most_waiting: int = MOST_WAITING) -> None:
        self.dropped = 0
        self.shed = 0
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
        seen: set[tuple[int, ...]] = set()
        kept: deque[Arrived] = deque()
        for arrived in reversed(self._frames):
            _, frame = arrived
            if _is_stream(frame.message_id):
                number = imu_number(frame) if frame.message_id in IMU_MESSAGES else 0
                stream = (frame.system_id, frame.component_id, frame.message_id, number)
                if stream in seen:
                    self._count_shed(frame, number)
                    continue
                seen.add(stream)
            kept.appendleft(arrived)
        while len(kept) > self._most_waiting:
            kept.popleft()
            self.dropped += 1
        self._frames = kept

    def _count_shed(self, frame: Frame, number: int) -> None:
        message = IMU_MESSAGES.get(frame.message_id)
        if message is not None:
            vehicle = VehicleId(frame.system_id, frame.component_id)
            self._unreported[vehicle, imu_stream_name(message.name, number)] += 1
            self.shed += 1


def _is_stream(message_id: int) -> bool:
    """Whether a newer message makes an older one old; the tables may be extended."""
    return message_id in IMU_MESSAGES or message_id in MESSAGES or message_id in WHO_IS_THERE
