"""Copies of a vehicle's stream that come late, by a second link or over the same wire.

A router may have two ways to one vehicle, one of them seconds behind. An IMU frame that comes again
with the same stamp and the same readings proves such a copy, and how late it is. From then on all
stamped frames of the address that are as late are known for copies, also those whose originals were
lost. Only a repeated frame is proof: a clock that is ahead may be another vehicle's.
"""

from functools import cache

from drivers.mavlink.fields import layout
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import IMU_MESSAGES
from drivers.mavlink.messages import MESSAGES

LATE_US = 300_000  # a frame that comes again earlier is a mere duplicate, which the clock refuses
YOUNG_US = 10_000_000  # boot time; a vehicle that starts again may repeat what it sent first
MEMORY_US = 10_000_000  # copies that are later than that are not found
COPIES_US = 2_000_000  # without a copy for so long there are none any more
PROOFS = 3  # repeated frames that show a late copy
REMEMBERED = 3  # frames are remembered whose hash has none of these bits: one in four
MOST_REMEMBERED = 4096  # frames of an address in MEMORY_US
STAMPS = {"time_usec": (8, 1), "time_boot_ms": (4, 1000)}  # bytes, and us a unit


class _Address:
    """What is known of one address: its latest frames, and how late copies of them come."""

    __slots__ = ("delay_us", "fresh", "late_us", "older", "proofs", "recent", "source", "turned_us")

    def __init__(self, now_us: int) -> None:
        self.recent: dict[int, tuple[int, str]] = {}  # arrival and peer, by the frame's hash
        self.older: dict[int, tuple[int, str]] = {}
        self.turned_us = now_us
        self.fresh: dict[int, tuple[int, int]] = {}  # offset and arrival, by message
        self.proofs = 0
        self.delay_us = 0  # of the copies
        self.late_us = 0  # arrival of the last copy
        self.source = ""  # the peer that brings the originals


class StreamCopies:
    """Looks at each frame of a link or log; ``late_peers`` is when each peer last proved late."""

    def __init__(self) -> None:
        self._addresses: dict[tuple[int, int], _Address] = {}
        self._late_peers: dict[tuple[int, int, str], int] = {}

    def source(self, frame: Frame, peer: str, arrival_us: int) -> str | None:
        """The peer that brings the original if the frame is a late copy; None if it is none."""
        stamp = _stamp(frame.message_id)
        if stamp is None:
            return None
        size, unit_us = stamp
        address = (frame.system_id, frame.component_id)
        known = self._addresses.get(address)
        if known is None:
            known = self._addresses[address] = _Address(arrival_us)
        payload = frame.data[frame.payload_at : frame.payload_end]
        time_us = int.from_bytes(payload[:size], "little") * unit_us
        if frame.message_id in IMU_MESSAGES and time_us > YOUNG_US:
            key = hash(payload)
            if not key & REMEMBERED and self._repeats(known, key, peer, arrival_us):
                self._late_peers[*address, peer] = arrival_us
        if self._is_late(known, frame.message_id, arrival_us - time_us, arrival_us):
            known.late_us = arrival_us
            return known.source
        if known.proofs < PROOFS or peer == known.source:
            known.fresh[frame.message_id] = (arrival_us - time_us, arrival_us)
        return None

    def is_late(self, address: tuple[int, int], peer: str, arrival_us: int) -> bool:
        """Whether a peer has lately brought copies of frames that another one had brought."""
        late_us = self._late_peers.get((*address, peer))
        known = self._addresses.get(address)
        if late_us is None or known is None or known.source == peer:
            return False
        return 0 <= arrival_us - late_us < MEMORY_US

    def forget(self, addresses: set[tuple[int, int]]) -> None:
        """Keep only these addresses."""
        self._addresses = {k: known for k, known in self._addresses.items() if k in addresses}
        self._late_peers = {k: us for k, us in self._late_peers.items() if k[:2] in addresses}

    def _repeats(self, known: _Address, key: int, peer: str, arrival_us: int) -> bool:
        """Whether an IMU frame was there before, long enough ago; remembers it if not."""
        is_old = not 0 <= arrival_us - known.turned_us < MEMORY_US
        if is_old or len(known.recent) >= MOST_REMEMBERED:
            known.older, known.recent, known.turned_us = known.recent, {}, arrival_us
        before = known.recent.get(key) or known.older.get(key)
        if before is None:
            known.recent[key] = (arrival_us, peer)
            return False
        delay_us = arrival_us - before[0]
        if delay_us < LATE_US:
            return False
        if arrival_us - known.late_us > COPIES_US or abs(delay_us - known.delay_us) > delay_us // 2:
            known.proofs = 0
        known.proofs += 1
        known.delay_us, known.late_us, known.source = delay_us, arrival_us, before[1]
        return known.proofs >= PROOFS

    def _is_late(self, known: _Address, message_id: int, offset_us: int, arrival_us: int) -> bool:
        """Whether a frame is as late as the copies are, while the originals come."""
        if known.proofs < PROOFS or not 0 <= arrival_us - known.late_us < COPIES_US:
            return False
        fresh = known.fresh.get(message_id)
        if fresh is None or not 0 <= arrival_us - fresh[1] < MEMORY_US:
            return False
        behind_us = offset_us - fresh[0]
        return known.delay_us // 2 < behind_us < known.delay_us * 3 // 2


@cache
def _stamp(message_id: int) -> tuple[int, int] | None:
    """Size and unit of the time that a message begins with; None if it is not used or has none."""
    known = layout(message_id) if message_id in IMU_MESSAGES or message_id in MESSAGES else None
    return None if known is None else STAMPS.get(known.names[0])
