"""The one queue of the live path: frames that were recorded and wait to be decoded.

It is bounded. Only when it is full is anything left out: of each sender's streams (one message of
one IMU) the newest frame stays, in its place, and older ones go. A newer sample of a vehicle is
worth more than an older one, and what says something once (a parameter, an answer) stays.
"""

from collections import Counter, deque
from collections.abc import Iterable
from typing import NamedTuple

from drivers.events import Shed, VehicleId
from drivers.mavlink.constants import AUTOPILOT_VERSION_ID, HEARTBEAT_ID
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import IMU_MESSAGES, imu_number, imu_stream_name
from drivers.mavlink.messages import MESSAGES

MOST_WAITING = 4096  # frames: 0.4 s of 200 vehicles at 50 Hz
REPORT_EVERY_US = 250_000  # how often what was left out is reported


class Arrived(NamedTuple):
    """A frame and when it arrived (host's Unix time)."""

    arrival_us: int
    frame: Frame


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
        self._frames.extend([Arrived(arrival_us, frame) for frame in frames])
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
            frame = arrived.frame
            if frame.message_id in _STREAMS:
                number = imu_number(frame)
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


class _Streams:
    """Messages of which a newer one makes an older one old; the tables may be extended."""

    _WHO_IS_THERE = frozenset({HEARTBEAT_ID, AUTOPILOT_VERSION_ID})

    def __contains__(self, message_id: int) -> bool:
        return (
            message_id in IMU_MESSAGES or message_id in MESSAGES or message_id in self._WHO_IS_THERE
        )


_STREAMS = _Streams()
