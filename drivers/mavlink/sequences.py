"""Two senders with one address on one wire, told by their sequence counters.

MAVLink's senders number their frames, 0 to 255 and again. Two of them on one wire are two counters
that go on in turns, which losses, late frames and repetitions of a single one do not look like.
Source: https://mavlink.io/en/guide/serialization.html#packet_format
"""

from collections.abc import Iterable
from collections.abc import Set as AbstractSet

from drivers.events import Notice
from drivers.mavlink.framing import MAGIC_V2, Frame

# Frames are looked at in stretches: two senders stay two, and a look at each frame costs too much.
EVERY_US = 10_000_000
STRETCH_US = 2_000_000
SETTLE_US = 500_000  # of a stretch: what is late by two ways has come by then
NEAR = 100  # frames; a number comes again after 256
LATE = 24  # frames; what comes so far behind a later number is late
TURNS = 8  # from one counter to the other within a stretch
MOST_ADDRESSES = 16  # in a stretch; each address has its turn
MOST_CHECKED = 1024
MOST_TOLD = 64


class _Counter:
    """One sender's last number, and whether the next one has ever followed."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.goes_on = False

    def follows(self, number: int) -> bool:
        return number == (self.number + 1) & 0xFF


class _Counters:
    """What one address has counted: at most two counters at a time."""

    def __init__(self, number: int) -> None:
        self.turns = 0
        self._latest = _Counter(number)
        self._other: _Counter | None = None
        self._frames = 0
        self._seen: dict[int, tuple[int, bytes]] = {}  # by number: which frame it was

    def take(self, number: int, data: bytes) -> int:
        """Follow one frame; 1 if it speaks for two senders, else 0.

        One that comes twice, by two ways, does not, nor one that is late.
        """
        self._frames += 1
        before = self._seen.get(number)
        if before is not None and before[1] == data:
            return 0
        has_namesake = self._has_seen(number, NEAR)
        self._seen[number] = self._frames, data
        return int(self._follow(number) or has_namesake)

    def _is_late(self, number: int) -> bool:
        return any(self._has_seen(number + ahead, LATE) for ahead in range(1, LATE + 1))

    def _has_seen(self, number: int, ago: int) -> bool:
        seen = self._seen.get(number & 0xFF)
        return seen is not None and self._frames - seen[0] < ago

    def _follow(self, number: int) -> bool:
        """Whether the frame turns from one counter that goes on to another one."""
        latest, other = self._latest, self._other
        if latest.follows(number):
            latest.number, latest.goes_on = number, True
        elif self._is_late(number):
            return False
        elif other is not None and other.follows(number):
            turns = other.goes_on and latest.goes_on
            other.number, other.goes_on = number, True
            self._latest, self._other = other, latest
            return turns
        else:  # frames were lost, or it is another sender's
            self._other = _Counter(number)
        return False


class SequenceWatch:
    """Looks at the frames of one link and says once which address has two senders.

    An address is ``system << 8 | component``.
    """

    def __init__(self) -> None:
        self._begun_us: int | None = None
        self._counters: dict[tuple[str, int], _Counters] = {}
        self._checked: set[int] = set()  # in this round of stretches
        self._told: set[int] = set()

    def looked_at(self, senders: Iterable[int]) -> AbstractSet[int]:
        """Of the addresses that send in a stretch, those whose frames :meth:`look` is to see.

        The others do not wait for it: it has room for a few at a time.
        """
        new = sorted({*senders} - self._checked)[: MOST_ADDRESSES - len(self._counters)]
        return {*new, *(address for _, address in self._counters)} - self._told

    def look(self, peer: str, frames: Iterable[Frame], now_us: int) -> list[Notice]:
        """A line for each address that proves to have two senders; nearly always none."""
        since_us = self.since_us(now_us)
        if since_us > STRETCH_US:
            return []
        is_settled = since_us >= SETTLE_US
        found = [self._take(peer, frame, now_us, is_settled=is_settled) for frame in frames]
        return [notice for notice in found if notice is not None]

    def since_us(self, now_us: int) -> int:
        """How long the stretch has lasted; the next begins where it is time for it."""
        begun_us = self._begun_us
        if begun_us is not None and 0 <= now_us - begun_us < EVERY_US:
            return now_us - begun_us
        self._begun_us = now_us
        if not self._counters or len(self._checked) > MOST_CHECKED:
            self._checked.clear()
        self._counters.clear()
        return 0

    def _take(self, peer: str, frame: Frame, now_us: int, *, is_settled: bool) -> Notice | None:
        data, address = frame.data, frame.system_id << 8 | frame.component_id
        if address in self._told:
            return None
        number = data[4] if data[0] == MAGIC_V2 else data[2]
        counters = self._counters.get((peer, address))
        if counters is None:
            if len(self._counters) < MOST_ADDRESSES and address not in self._checked:
                self._checked.add(address)
                self._counters[peer, address] = _Counters(number)
            return None
        turns = counters.take(number, data)
        if is_settled:
            counters.turns += turns
        if counters.turns < TURNS or len(self._told) >= MOST_TOLD:
            return None
        self._told.add(address)
        text = "two senders use its address on one wire: two vehicles, or one by two ways"
        return Notice(None, now_us, f"system {frame.system_id}: {text}")
