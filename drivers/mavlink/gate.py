"""Which frames of a link or log are let in: allowed systems, good signatures, one sender each.

Of a stream that comes twice the fresher copy is let in.
"""

from collections import Counter
from typing import NamedTuple

from drivers.events import Event, Notice, RefusedFrames, VehicleId
from drivers.mavlink.copies import StreamCopies
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import IMU_MESSAGES
from drivers.mavlink.signing import SigningCheck
from estimator.reasons import Reason

# Another sender of the same address may take over once the first has been silent for so long
TAKE_OVER_US = 1_000_000
TOGETHER_US = 100_000  # what has come in such a time is not always judged in its order
MOST_SENDERS = 1024  # before those are dropped that have been silent for longer than that
MOST_TOLD = 64  # a flood of addresses does not fill memory or the screen

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


class _Sender(NamedTuple):
    peer: str
    last_us: int


class FrameGate:
    """Judges frames one by one and counts what it refuses."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self._own = policy.own
        self._copies = StreamCopies()
        self._senders: dict[tuple[int, int], _Sender] = {}
        self._most_senders = MOST_SENDERS
        self._refused: Counter[tuple[VehicleId, Reason]] = Counter()
        self._told: set[tuple[VehicleId, Reason]] = set()

    def let_in(self, frames: list[Frame], peer: str, arrival_us: int) -> list[Frame]:
        """The good ones of frames that came together; the others are counted."""
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
        """What was refused since the last call, and a line for each new reason."""
        if not self._refused:
            return []
        events: list[Event] = []
        for (vehicle, reason), frames in self._refused.items():
            events.append(RefusedFrames(vehicle, arrival_us, reason, frames))
            known = (vehicle, reason) in self._told or len(self._told) >= MOST_TOLD
            if not known and reason in EXPLANATIONS:
                self._told.add((vehicle, reason))
                text = f"system {vehicle.system_id}: {EXPLANATIONS[reason]}"
                events.append(Notice(None, arrival_us, text))
        self._refused.clear()
        return events

    def forget(self, peer: str | None = None) -> None:
        """A peer has left, or all have: another may speak for its vehicles at once."""
        self._senders = {
            address: sender
            for address, sender in self._senders.items()
            if peer is not None and sender.peer != peer
        }

    def _refusal(
        self, frame: Frame, address: tuple[int, int], peer: str, arrival_us: int
    ) -> Reason | None:
        systems, signing = self._policy.system_ids, self._policy.signing
        if systems is not None and frame.system_id not in systems:
            return Reason.SYSTEM_NOT_ALLOWED
        if signing is not None:
            refusal = signing.refusal(frame, arrival_us)
            if refusal is not None:
                return refusal
        sender = self._senders.get(address)
        source = self._copies.source(frame, peer, arrival_us)
        if source is not None:
            if source != peer:  # whoever brings the originals is followed
                self._senders[address] = _Sender(source, arrival_us)
            return Reason.DUPLICATE
        if sender is not None and sender.peer != peer:
            if self._copies.is_late(address, peer, arrival_us):
                return Reason.DUPLICATE
            if self._is_heard(sender, arrival_us):
                return Reason.ADDRESS_CONFLICT
            sender = None
        if sender is None or sender.last_us != arrival_us:  # once for all frames of a datagram
            self._senders[address] = _Sender(peer, arrival_us)
            if sender is None and len(self._senders) > self._most_senders:
                self._drop_silent(arrival_us)
        return None

    def _is_heard(self, sender: _Sender, now_us: int) -> bool:
        """Whether the sender of an address still speaks."""
        return -TOGETHER_US <= now_us - sender.last_us < TAKE_OVER_US

    def _drop_silent(self, now_us: int) -> None:
        """Drop what means nothing any more; a flood is looked through each time it has doubled."""
        self._senders = {
            address: sender
            for address, sender in self._senders.items()
            if self._is_heard(sender, now_us)
        }
        self._most_senders = max(MOST_SENDERS, 2 * len(self._senders))
        self._copies.forget(set(self._senders))
