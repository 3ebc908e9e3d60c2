"""Frames that wait to be decoded, and what of them is left out when they wait for too long.

Where more arrives than can be handled, a newer sample of a vehicle is worth more than an older
one. So once frames have waited for longer than :data:`PATIENCE_S`, and not for a moment alone, only
the newest of each sender's streams stays, in the place of the oldest: whoever has waited longest is
next, nobody starves, and nothing that is taken is older than the interval at which its sender
sends. No load has to be measured for that, and nothing is left out while there is time for it.
"""

import math
import time
from collections import ChainMap, Counter, deque
from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from drivers.events import Shed, VehicleId
from drivers.mavlink.constants import AUTOPILOT_VERSION_ID, HEARTBEAT_ID
from drivers.mavlink.framing import ADDRESSES, Frame
from drivers.mavlink.imu_messages import IMU_MESSAGES, imu_number, imu_stream_name
from drivers.mavlink.messages import MESSAGES

# Of what tells who is there the newest stays.
WHO_IS_THERE = frozenset({HEARTBEAT_ID, AUTOPILOT_VERSION_ID})
# A newer one of these makes an older one old; what is said once (a parameter, an answer) stays.
# Extensions add to these, so that it is a view and no copy.
STREAMS = ChainMap[int, Any](IMU_MESSAGES, MESSAGES, dict.fromkeys(WHO_IS_THERE))
# One period of a common stream, 50 Hz: with the wait for the next tick, attitudes stay younger
# than two.
PATIENCE_S = 0.02
# A stall that comes alone is caught up with, and costs nothing but this delay. Where something was
# left out shortly before, it is no stall but too much.
STALL_S = 0.15
ALONE_S = 2.0
# A newcomer's frames all wait, but for so long only: else its first attitudes are old, and to go
# through all that it has said takes the time in which others would begin.
LONGEST_NEW_S = 0.5
# Whoever has not looked for so long was stopped: what has piled up is not gone through one by one.
STOPPED_S = 0.25
# What was left out is told this often: to hear of it costs as much as to take a sample.
TOLD_EVERY_US = 250_000
# So many frames are decoded at one go, before whoever takes them can do something else: 1 ms or so.
MOST_AT_ONCE = 64
# A sender's first IMU sample costs as much as a hundred later ones (an estimator begins): so many
# senders begin at one go, which takes a period of a common stream.
MOST_NEWCOMERS = 25
# What cannot be left out is bounded, too: the oldest goes, and is counted.
MOST_WAITING = 50_000


# Of the time in which this process does not get the processor such a share counts.
IDLE_SHARE = 1.0 / 3.0


def waiting_clock_s() -> float:
    """A clock that runs at a third of its speed while this process does not get the processor, s.

    Frames that wait because others had the processor are no sign of too much to do, and may be
    caught up with. But they must not wait for long, either: attitudes would be old.
    """
    return time.process_time() * (1.0 - IDLE_SHARE) + time.monotonic() * IDLE_SHARE


class Arrived(NamedTuple):
    """A frame and when it arrived (host's Unix time)."""

    arrival_us: int
    frame: Frame


class _Turn:
    """A frame that waits for its turn, and since when."""

    __slots__ = ("arrived", "since_s")

    def __init__(self, arrived: Arrived, since_s: float) -> None:
        self.arrived = arrived
        self.since_s = since_s


class Patience:
    """Tells when frames have waited for too long, which a stall that comes alone may last."""

    def __init__(self) -> None:
        self._short_s = -math.inf  # when nothing had waited for long
        self._folded_s = -math.inf  # when something was left out

    def is_out(self, since_s: float | None, now_s: float) -> bool:
        """Whether some of what has waited ``since_s`` is to be left out; None: nothing waits."""
        if since_s is None or now_s - since_s <= PATIENCE_S:
            self._short_s = now_s
            return False
        is_alone = now_s - self._folded_s > ALONE_S
        return not is_alone or now_s - self._short_s > STALL_S

    def note_folded(self, now_s: float) -> None:
        """Something was left out."""
        self._folded_s = now_s


class Backlog:
    """Frames in the order of their turn. Times are given, in s.

    How long frames have waited is told by :func:`waiting_clock_s`, looks by the wall's clock.

    ``dropped`` counts frames that were too many, ``shed`` IMU samples that were left out.
    """

    def __init__(self, most_waiting: int = MOST_WAITING) -> None:
        self.dropped = 0
        self.shed = 0
        self._most_waiting = most_waiting
        self._turns: deque[_Turn] = deque()
        # the newest turn of each stream, while there is more than can be done; else None
        self._streams: dict[tuple[int, ...], _Turn] | None = None
        self._newcomers: dict[int, list[_Turn]] = {}  # by address: from the first IMU sample on
        # by address, as system << 8 | component: whether an IMU sample was taken
        self.has_come = np.zeros(ADDRESSES, np.bool_)
        self._uncounted: Counter[tuple[VehicleId, str]] = Counter()
        self._told_us = -TOLD_EVERY_US
        self._looked_s: float | None = None
        self._patience = Patience()

    def __len__(self) -> int:
        return len(self._turns) + sum(map(len, self._newcomers.values()))

    def __bool__(self) -> bool:
        return bool(self._turns or self._newcomers)

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing waits, and all is done since there was too much."""
        return self._streams is None and not self._turns and not self._newcomers

    @property
    def has_turns(self) -> bool:
        """Whether there is more than newcomers."""
        return bool(self._turns)

    @property
    def has_newcomers(self) -> bool:
        """Whether some wait to begin."""
        return bool(self._newcomers)

    def add(self, arrived: Iterable[Arrived], now_s: float) -> None:
        """Put frames at the end, or in the place of older ones of their streams."""
        arrived = [each for each in arrived if not self._is_newcomers(each, now_s)]
        turns = self._turns
        since_s = turns[0].since_s if turns else None
        if self._patience.is_out(since_s, now_s) and self._streams is None:
            self.fold()
        if self._streams is None:
            turns.extend([_Turn(each, now_s) for each in arrived])
        else:
            self._patience.note_folded(now_s)
            for each in arrived:
                self._put(each, now_s, self._streams)
        while len(self._turns) > self._most_waiting:
            self._remove_first()
            self.dropped += 1

    def note_look(self, now_s: float) -> None:
        """All that has arrived is here now; to be called again and again, if nothing has, too."""
        if self.was_stopped(now_s):
            self.fold()
        self._looked_s = now_s

    def was_stopped(self, now_s: float) -> bool:
        """Whether nobody has looked for long."""
        return self._looked_s is not None and now_s - self._looked_s > STOPPED_S

    @property
    def senders(self) -> set[int]:
        """Whose frames wait for their turn, by address."""
        if not self._turns:  # as nearly always
            return set()
        frames = (turn.arrived.frame for turn in self._turns)
        return {frame.system_id << 8 | frame.component_id for frame in frames}

    def note_shed(self, vehicle: VehicleId, stream: str, samples: int) -> None:
        """Count IMU samples that were left out."""
        self._uncounted[vehicle, stream] += samples
        self.shed += samples

    def take(self) -> list[Arrived]:
        """The next frames, and all that some newcomers have said."""
        taken = [self._remove_first() for _ in range(min(MOST_AT_ONCE, len(self._turns)))]
        if not self._turns:
            self._streams = None  # all is done: what comes now can be handled, too
        for address in list(islice(self._newcomers, MOST_NEWCOMERS)):
            taken += [turn.arrived for turn in self._newcomers.pop(address)]
            self.has_come[address] = True
        return taken

    def fold(self) -> None:
        """Leave out all but the newest of each sender's streams, until nothing waits any more."""
        turns, self._turns, self._streams = self._turns, deque(), {}
        for turn in turns:
            self._put(turn.arrived, turn.since_s, self._streams)

    @property
    def is_folded(self) -> bool:
        """Whether there has been too much since nothing waited last."""
        return self._streams is not None

    def overtake(self, senders: AbstractSet[int]) -> None:
        """Leave out what waits of the streams of those of whom something newer passes."""
        if self._streams is None:
            return
        turns, self._turns = self._turns, deque()
        for turn in turns:
            frame = turn.arrived.frame
            is_old = _is_in_stream(frame) and frame.message_id not in WHO_IS_THERE
            if is_old and frame.system_id << 8 | frame.component_id in senders:
                self._count(frame)
                self._streams.pop(_stream(frame), None)
            else:
                self._turns.append(turn)

    def take_shed(self, arrival_us: int) -> list[Shed]:
        """IMU samples that have been left out, which count, if it is time to tell."""
        if not self._uncounted or 0 <= arrival_us - self._told_us < TOLD_EVERY_US:
            return []
        self._told_us = arrival_us
        shed = [
            Shed(vehicle, arrival_us, message, samples)
            for (vehicle, message), samples in self._uncounted.items()
        ]
        self._uncounted.clear()
        return shed

    def _is_newcomers(self, arrived: Arrived, now_s: float) -> bool:
        """Keep a frame of who has an IMU of which no sample was taken yet; False for all else."""
        frame = arrived.frame
        address = frame.system_id << 8 | frame.component_id
        if self.has_come[address]:
            return False
        turns = self._newcomers.get(address)
        if turns is None:
            if frame.message_id not in IMU_MESSAGES:
                return False
            turns = self._newcomers[address] = []
        turns.append(_Turn(arrived, now_s))
        if now_s - turns[0].since_s > LONGEST_NEW_S:
            self._newcomers[address] = self._newest(turns, now_s)
        return True

    def _newest(self, turns: list[_Turn], now_s: float) -> list[_Turn]:
        """Of a newcomer's streams the newest frames, of all else everything."""
        newest: dict[tuple[int, ...], _Turn] = {}
        for number, turn in enumerate(turns):
            frame = turn.arrived.frame
            key = _stream(frame) if _is_in_stream(frame) else (number,)
            before = newest.pop(key, None)
            if before is not None:
                self._count(before.arrived.frame)
            newest[key] = turn
            turn.since_s = now_s
        return list(newest.values())

    def _put(self, arrived: Arrived, now_s: float, streams: dict[tuple[int, ...], _Turn]) -> None:
        key = _stream(arrived.frame)
        turn = streams.get(key)
        if turn is not None:
            self._count(turn.arrived.frame)
            turn.arrived, turn.since_s = arrived, now_s
            return
        turn = _Turn(arrived, now_s)
        self._turns.append(turn)
        if _is_in_stream(arrived.frame):
            streams[key] = turn

    def _remove_first(self) -> Arrived:
        arrived = self._turns.popleft().arrived
        if self._streams is not None:
            self._streams.pop(_stream(arrived.frame), None)
        return arrived

    def _count(self, frame: Frame) -> None:
        """Count a frame that is left out."""
        message = IMU_MESSAGES.get(frame.message_id)
        if message is not None:
            vehicle = VehicleId(frame.system_id, frame.component_id)
            self.note_shed(vehicle, imu_stream_name(message.name, imu_number(frame)), 1)


def _stream(frame: Frame) -> tuple[int, ...]:
    """Whose stream it is, and which."""
    return frame.system_id, frame.component_id, frame.message_id, imu_number(frame)


def _is_in_stream(frame: Frame) -> bool:
    """Whether a newer frame of its kind makes this one old."""
    return frame.message_id in STREAMS
