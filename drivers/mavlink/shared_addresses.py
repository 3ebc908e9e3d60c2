"""Two senders with one address on one wire, found by their sequence numbers.

MAVLink's senders number their frames, 0 to 255 and again. Two of them on one wire are two counters
that go on in turns. Losses, late frames and copies of one sender's frames do not look like that.
Source: https://mavlink.io/en/guide/serialization.html#packet_format
"""

from collections import Counter

from drivers.events import Notice
from drivers.mavlink.framing import Frame

# Frames are looked at for the first 2 s of every 10: two senders stay two.
EVERY_US = 10_000_000
STRETCH_US = 2_000_000
SETTLE_US = 500_000  # of a stretch: what is late by two ways has come by then
NEAR = 100  # frames; a single sender's number comes again after 256
LATE = 24  # frames; what comes so far behind a later number is late
TURNS = 8  # from one counter to the other within a stretch
MOST_ADDRESSES = 64  # in a stretch
MOST_REPORTED = 64


class _Counters:
    """What one address has counted in a stretch: the last two counters, and what came."""

    __slots__ = ("_frames", "_latest", "_latest_goes_on", "_other", "_other_goes_on", "_seen")

    def __init__(self, number: int) -> None:
        self._latest, self._latest_goes_on = number, False
        self._other, self._other_goes_on = -1, False
        self._frames = 0
        self._seen: dict[int, tuple[int, bytes]] = {}  # by number: which frame it was

    def take(self, number: int, data: bytes) -> bool:
        """Follow one frame; whether it speaks for two senders.

        A copy of an earlier frame, by another way, does not, nor one that is late.
        """
        self._frames += 1
        before = self._seen.get(number)
        if before is not None and before[1] == data:
            return False
        has_namesake = self._has_seen(number, NEAR)
        self._seen[number] = self._frames, data
        if number == (self._latest + 1) & 0xFF:
            self._latest, self._latest_goes_on = number, True
            return has_namesake
        if any(self._has_seen(number + ahead, LATE) for ahead in range(1, LATE + 1)):
            return has_namesake
        if self._other >= 0 and number == (self._other + 1) & 0xFF:
            is_turn = self._other_goes_on and self._latest_goes_on
            self._other, self._other_goes_on = self._latest, self._latest_goes_on
            self._latest, self._latest_goes_on = number, True
            return is_turn or has_namesake
        self._other, self._other_goes_on = number, False  # losses, or another sender
        return has_namesake

    def _has_seen(self, number: int, ago: int) -> bool:
        seen = self._seen.get(number & 0xFF)
        return seen is not None and self._frames - seen[0] < ago


class SharedAddresses:
    """Reports once which address has two senders on one wire."""

    def __init__(self) -> None:
        self._begun_us: int | None = None
        self._counters: dict[tuple[str, int, int], _Counters] = {}
        self._turns: Counter[tuple[int, int]] = Counter()
        self._reported: set[tuple[int, int]] = set()

    def look(self, peer: str, frames: list[Frame], now_us: int) -> list[Notice]:
        """A line for each address that proves to have two senders; nearly always none."""
        if self._begun_us is None or not 0 <= now_us - self._begun_us < EVERY_US:
            self._begun_us = now_us
            self._counters.clear()
            self._turns.clear()
        if now_us - self._begun_us > STRETCH_US:
            return []
        found = (self._take(peer, frame, now_us) for frame in frames)
        return [notice for notice in found if notice is not None]

    def _take(self, peer: str, frame: Frame, now_us: int) -> Notice | None:
        data, address = frame.data, (frame.system_id, frame.component_id)
        number = frame.sequence
        counters = self._counters.get((peer, *address))
        if counters is None:
            if len(self._counters) < MOST_ADDRESSES:
                self._counters[peer, *address] = _Counters(number)
            return None
        is_settled = now_us - (self._begun_us or 0) >= SETTLE_US
        self._turns[address] += counters.take(number, data) and is_settled
        if self._turns[address] < TURNS or address in self._reported:
            return None
        if len(self._reported) >= MOST_REPORTED:
            return None
        self._reported.add(address)
        text = "two senders use its address on one wire: two vehicles, or one by two ways"
        return Notice(None, now_us, f"system {frame.system_id}: {text}")
