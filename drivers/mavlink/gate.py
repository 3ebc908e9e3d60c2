"""Which frames of a link or log are let in: allowed systems, good signatures, one sender each.

Two senders with one address are found by their peers, and on one wire by their sequence numbers.

Of a stream that comes twice the fresher copy is let in. A router may have two ways to one vehicle,
one of them seconds behind. An IMU frame that comes again with the same stamp and the same readings
is such a copy, and shows how late it is. Some of them are proof: from then on all stamped frames of
the address that are as late are known for copies, also those whose originals were lost. Only a
repeated frame is proof: a clock that is ahead may be another vehicle's.
"""

from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

from drivers.events import Event, Notice, RefusedFrames, VehicleId
from drivers.mavlink.framing import Frame, layout
from drivers.mavlink.messages import IMU_MESSAGES, MESSAGES
from drivers.mavlink.signing import SigningCheck
from drivers.samples.vehicle_clock import BOOT_US
from estimator.reasons import Reason

# Another sender of the same address may take over once the first has been silent for so long
TAKE_OVER_US = 1_000_000
TOGETHER_US = 100_000  # what has come in such a time is not always judged in its order
MOST_SENDERS = 1024  # before those are dropped that have been silent for longer than that
MOST_REPORTED = 64  # a flood of addresses does not fill memory or the screen

EXPLANATIONS = {
    Reason.UNSIGNED: "frames without a signature are refused",
    Reason.WRONG_SIGNATURE: "frames signed with another key are refused",
    Reason.REPLAYED: "frames with an old time stamp in their signature are refused",
    Reason.SIGNATURE_TOO_OLD: "its signatures are more than a minute old, set its clock (or ours)",
    Reason.SIGNATURE_TOO_NEW: "its signatures are from the future, set our clock (or its)",
    Reason.ADDRESS_CONFLICT: "a second sender uses the same address and is ignored",
}


class Policy(NamedTuple):
    """What is let in; None means no such check.

    ``own`` is the address that this program's attitudes are sent from: forwarded back, they are no
    vehicle's.
    """

    system_ids: frozenset[int] | None = None
    signing: SigningCheck | None = None
    own: VehicleId | None = None


@dataclass(slots=True)
class _Address:
    """Who sends for an address, when something came last, and what copies there are."""

    peer: str | None = None
    last_us: int = 0
    copies: "StreamCopies | None" = None  # of an IMU's address

    def is_active(self, now_us: int) -> bool:
        """Whether somebody still sends."""
        return self.peer is not None and -TOGETHER_US <= now_us - self.last_us < TAKE_OVER_US


class FrameGate:
    """Judges frames one by one and counts what it refuses."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._own = policy.own
        self._addresses: dict[tuple[int, int], _Address] = {}
        self._most_addresses = MOST_SENDERS
        self._shared = SharedAddresses()
        self._refused: Counter[tuple[VehicleId, Reason]] = Counter()
        self._notices: list[Event] = []
        self._reported: set[tuple[VehicleId, Reason]] = set()

    def let_in(self, frames: list[Frame], peer: str, arrival_us: int) -> list[Frame]:
        """The good ones of frames that came together; the others are counted."""
        self._notices += self._shared.look(peer, frames, arrival_us)
        return [frame for frame in frames if self.lets_in(frame, peer, arrival_us)]

    def lets_in(self, frame: Frame, peer: str, arrival_us: int) -> bool:
        """Whether the frame is good; if not, it is counted, unless this program has sent it."""
        address = (frame.system_id, frame.component_id)
        if address == self._own:
            if frame.message_id not in IMU_MESSAGES:
                return False
            self._own = None  # this program sends none: there is a vehicle of that address
        reason = self._refusal(frame, address, peer, arrival_us)
        if reason is None:
            return True
        self._refused[VehicleId(*address), reason] += 1
        return False

    def keep(self, unix_us: int) -> None:
        """Have what was let in outlast a crash, before it is used."""
        if self._policy.signing is not None:
            self._policy.signing.keep_ahead(unix_us)

    def take_refused(self, arrival_us: int) -> list[Event]:
        """What was refused since the last call; lines for new reasons and shared addresses."""
        events, self._notices = self._notices, []
        for (vehicle, reason), frames in self._refused.items():
            events.append(RefusedFrames(vehicle, arrival_us, reason, frames))
            known = (vehicle, reason) in self._reported or len(self._reported) >= MOST_REPORTED
            if not known and reason in EXPLANATIONS:
                self._reported.add((vehicle, reason))
                text = f"system {vehicle.system_id}: {EXPLANATIONS[reason]}"
                events.append(Notice(None, arrival_us, text))
        self._refused.clear()
        return events

    def forget(self, peer: str | None = None) -> None:
        """A peer has left, or all have: another may send for its vehicles at once."""
        for known in self._addresses.values():
            if peer in (None, known.peer):
                known.peer = None
        items = self._addresses.items()
        self._addresses = {at: each for at, each in items if each.peer or each.copies}

    def _refusal(
        self, frame: Frame, address: tuple[int, int], peer: str, arrival_us: int
    ) -> Reason | None:
        systems, signing = self._policy.system_ids, self._policy.signing
        if systems is not None and frame.system_id not in systems:
            return Reason.SYSTEM_NOT_ALLOWED
        if signing is not None and (refusal := signing.refusal(frame, arrival_us)) is not None:
            return refusal
        known = self._addresses.get(address) or self._meet(address, arrival_us)
        copies, is_repeat, is_imu = known.copies, False, frame.message_id in IMU_MESSAGES
        if copies is None and is_imu:
            copies = known.copies = StreamCopies()
        if copies is not None and (is_imu or copies.proofs):
            source, is_repeat = copies.look(frame, peer, arrival_us)
            if source is not None:
                if source != peer:  # follow the sender of the originals
                    known.peer, known.last_us = source, arrival_us
                return Reason.DUPLICATE
        if known.peer not in (None, peer):
            if copies is not None and copies.is_late(peer, arrival_us):
                return Reason.DUPLICATE
            if known.is_active(arrival_us):
                return Reason.ADDRESS_CONFLICT
        if is_repeat:
            return Reason.DUPLICATE
        known.peer, known.last_us = peer, arrival_us
        return None

    def _meet(self, address: tuple[int, int], now_us: int) -> _Address:
        """A new address; in a flood silent ones go when their number has doubled."""
        if len(self._addresses) >= self._most_addresses:
            items = self._addresses.items()
            self._addresses = {at: each for at, each in items if each.is_active(now_us)}
            self._most_addresses = max(MOST_SENDERS, 2 * len(self._addresses))
        known = self._addresses[address] = _Address()
        return known


# A frame that comes again earlier is refused by the clock: it looks like no reset
LEAST_US = 40_000
LATE_US = 300_000  # from here on copies are known by their lateness, too
MEMORY_US = 10_000_000  # copies that are later than that are not found
COPIES_US = 2_000_000  # without a copy for so long there are none any more
PROOFS = 10  # repeated frames that show a late copy
MOST_REMEMBERED = 16_384  # frames of an address in MEMORY_US
STAMPS = {"time_usec": (8, 1), "time_boot_ms": (4, 1000)}  # bytes, and us a unit


class Repeats:
    """Remembers for some seconds what has come, by the hash of each, and from whom."""

    def __init__(self) -> None:
        self._recent: dict[int, tuple[int, str]] = {}
        self._older: dict[int, tuple[int, str]] = {}
        self._turned_us = 0

    def before(self, key: int, now_us: int, peer: str = "") -> tuple[int, str] | None:
        """When the same has come before, and from whom; remembers it if it has not."""
        found = self._recent.get(key) or self._older.get(key)
        if found is None:
            is_old = not 0 <= now_us - self._turned_us < MEMORY_US
            if is_old or len(self._recent) >= MOST_REMEMBERED:
                self._older, self._recent, self._turned_us = self._recent, {}, now_us
            self._recent[key] = (now_us, peer)
        return found


@dataclass(slots=True)
class StreamCopies:
    """The latest frames of one address, and how late copies of them come."""

    repeats: Repeats = field(default_factory=Repeats)
    fresh: dict[int, tuple[int, int]] = field(default_factory=dict)  # offset, arrival; by message
    proofs: int = 0
    delay_us: int = 0  # of the copies
    late_us: int = 0  # arrival of the last copy
    source: str = ""  # the peer that brings the originals
    is_repeat: bool = False  # the last IMU frame
    latest_us: int = 0  # stamp of the last that was none
    mixed_us: int = 0  # arrival of the last that came right behind one, and was new
    late_peers: dict[str, int] = field(default_factory=dict)  # when each proved late last

    def look(self, frame: Frame, peer: str, arrival_us: int) -> tuple[str | None, bool]:
        """The peer that brings the original if the frame is a late copy; whether it is a repeat."""
        is_imu, stamp = frame.message_id in IMU_MESSAGES, _stamp(frame.message_id)
        if stamp is None:
            return None, False
        size, unit_us = stamp
        payload = frame.data[frame.payload_at : frame.payload_end]
        time_us = int.from_bytes(payload[:size], "little") * unit_us
        is_repeat = is_imu and self._repeats(hash(payload), peer, time_us, arrival_us)
        if not self.proofs:
            return None, is_repeat
        if self._is_late(frame.message_id, arrival_us - time_us, arrival_us):
            self.late_us = arrival_us
            return self.source, is_repeat
        if not is_repeat and (self.proofs < PROOFS or peer == self.source):
            self.fresh[frame.message_id] = (arrival_us - time_us, arrival_us)
        return None, is_repeat

    def is_late(self, peer: str, arrival_us: int) -> bool:
        """Whether a peer has lately brought copies of frames that another one had brought."""
        if peer == self.source or peer not in self.late_peers:
            return False
        return 0 <= arrival_us - self.late_peers[peer] < MEMORY_US

    def _repeats(self, key: int, peer: str, time_us: int, arrival_us: int) -> bool:
        """Whether an IMU frame is a copy of one that came before; some prove that its way is late.

        A vehicle that has just started may have started again, and repeat itself: there frames are
        copies where new ones come between them.
        """
        before = self.repeats.before(key, arrival_us, peer)
        if before is None:
            if self.is_repeat and time_us > self.latest_us:
                self.mixed_us = arrival_us
            self.is_repeat, self.latest_us = False, time_us
            return False
        self.is_repeat = True
        delay_us = arrival_us - before[0]
        if time_us <= BOOT_US:
            return delay_us >= LEAST_US and 0 <= arrival_us - self.mixed_us < COPIES_US
        if delay_us < LATE_US:
            return delay_us >= LEAST_US
        is_other = abs(delay_us - self.delay_us) > delay_us // 2
        if arrival_us - self.late_us > COPIES_US or is_other:
            self.proofs = 0
        self.proofs += 1
        self.delay_us, self.late_us, self.source = delay_us, arrival_us, before[1]
        if self.proofs >= PROOFS:
            self.late_peers[peer] = arrival_us
        return True

    def _is_late(self, message_id: int, offset_us: int, arrival_us: int) -> bool:
        """Whether a frame is as late as the copies are, while the originals come."""
        if self.proofs < PROOFS or not 0 <= arrival_us - self.late_us < COPIES_US:
            return False
        fresh = self.fresh.get(message_id)
        if fresh is None or not 0 <= arrival_us - fresh[1] < MEMORY_US:
            return False
        behind_us = offset_us - fresh[0]
        return self.delay_us // 2 < behind_us < self.delay_us * 3 // 2


@cache
def _stamp(message_id: int) -> tuple[int, int] | None:
    """Size and unit of the time that a message begins with; None if it is not used or has none."""
    known = layout(message_id) if message_id in IMU_MESSAGES or message_id in MESSAGES else None
    return None if known is None else STAMPS.get(known.names[0])


# MAVLink's senders number their frames, 0 to 255 and again. Two of them on one wire are two
# counters that go on in turns. Losses, late frames and copies of one sender's frames look
# different. Source: https://mavlink.io/en/guide/serialization.html#packet_format

# Frames are looked at for the first 2 s of every 10: two senders stay two.
EVERY_US = 10_000_000
STRETCH_US = 2_000_000
SETTLE_US = 500_000  # of a stretch: what is late by two ways has come by then
NEAR = 100  # frames; a single sender's number comes again after 256
LATE = 24  # frames; what comes so far behind a later number is late
TURNS = 8  # from one counter to the other within a stretch
MOST_ADDRESSES = 64  # in a stretch
SHARED = "two senders use its address on one wire: two vehicles, or one by two ways"


@dataclass(slots=True)
class _Counters:
    """The last two counters of one address in a stretch, and whether each has gone on."""

    latest: int
    latest_goes_on: bool = False
    other: int = -1
    other_goes_on: bool = False
    frames: int = 0
    seen: dict[int, tuple[int, bytes]] = field(default_factory=dict)  # by number: the last frame

    def take(self, number: int, data: bytes) -> bool:
        """Follow one frame; whether it is a sign of two senders.

        A copy of an earlier frame, by another way, is none, nor is a late frame.
        """
        self.frames += 1
        if number in self.seen and self.seen[number][1] == data:
            return False
        is_repeated = self._has_seen(number, NEAR)
        self.seen[number] = self.frames, data
        if number == (self.latest + 1) & 0xFF:
            self.latest, self.latest_goes_on = number, True
        elif any(self._has_seen(number + ahead, LATE) for ahead in range(1, LATE + 1)):
            pass  # late
        elif self.other >= 0 and number == (self.other + 1) & 0xFF:
            is_turn = self.other_goes_on and self.latest_goes_on
            self.other, self.other_goes_on = self.latest, self.latest_goes_on
            self.latest, self.latest_goes_on = number, True
            return is_turn or is_repeated
        else:
            self.other, self.other_goes_on = number, False  # losses, or another sender
        return is_repeated

    def _has_seen(self, number: int, ago: int) -> bool:
        seen = self.seen.get(number & 0xFF)
        return seen is not None and self.frames - seen[0] < ago


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
        is_settled = now_us - self._begun_us >= SETTLE_US
        notices = []
        for frame in frames:
            address = (frame.system_id, frame.component_id)
            counters = self._counters.get((peer, *address))
            if counters is None:
                if len(self._counters) < MOST_ADDRESSES:
                    self._counters[peer, *address] = _Counters(frame.sequence)
                continue
            self._turns[address] += counters.take(frame.sequence, frame.data) and is_settled
            is_new = address not in self._reported and len(self._reported) < MOST_REPORTED
            if self._turns[address] >= TURNS and is_new:
                self._reported.add(address)
                notices.append(Notice(None, now_us, f"system {frame.system_id}: {SHARED}"))
        return notices
