"""Whose bytes are worth reading when more come than can be: first those who send IMU data.

A flood of heartbeats costs as much to read as samples do, and none of it is wanted so often. A peer
without an IMU has a budget of packets a second, and all of them together have one; a peer with an
IMU has a larger one for what is no usual frame. What is larger than a frame counts as several.
"""

from collections.abc import Iterable
from math import inf
from typing import Any

from drivers.mavlink.framing import LONGEST_FRAME
from drivers.mavlink.imu_messages import IMU_MESSAGES

PACKETS_HZ = 200.0  # of a peer without an IMU: a ground station sends a tenth of that
ALL_PACKETS_HZ = 2000.0  # of all those together
IMU_PACKETS_HZ = 4000.0  # of one with an IMU, beside its lease: 1 MB/s
CLAIM_S = 5.0  # for so long an IMU sample counts
MOST_PEERS = 1024


def cost(size: Any) -> Any:
    """How many packets one of so many bytes counts for; of one or of an array."""
    return 1 + size // LONGEST_FRAME


class _Budget:
    """A second's worth of packets, refilled as time goes.

    What is small is let in before what is large, so that a flood of that keeps no newcomer out.
    """

    def __init__(self, rate_hz: float, now_s: float) -> None:
        self._rate_hz = self._left = rate_hz
        self._at_s = now_s

    def take(self, packets: int, now_s: float) -> bool:
        """Whether there are so many left; a full budget is enough for any."""
        packets = min(packets, int(self._rate_hz))
        if self.left(now_s) < packets:
            return False
        self._left -= packets
        return True

    def left(self, now_s: float) -> float:
        """How many packets are left."""
        self._left = min(self._rate_hz, self._left + self._rate_hz * (now_s - self._at_s))
        self._at_s = now_s
        return self._left


class Claims:
    """Tells whether a peer's packet is to be read; ``refused`` counts those that are not.

    Where ``is_proven`` who has an IMU (by signatures, that is), it has no budget.
    """

    def __init__(self, *, is_proven: bool = False) -> None:
        self.refused = 0
        self._is_proven = is_proven
        self._until_s: dict[str, float] = {}  # those with an IMU
        self._budgets: dict[tuple[str, bool], _Budget] = {}  # by peer, and whether it has one
        self._all = _Budget(ALL_PACKETS_HZ, 0.0)

    def admits(self, peer: str, size: int, since_s: float, now_s: float) -> bool:
        """Whether a packet of so many bytes is read that came ``since_s``, when all before was.

        Nobody's claim ends because nobody has looked.
        """
        has_imu = self._has_imu(peer, since_s)
        if has_imu and self._is_proven:
            return True
        budget = self._budget(peer, now_s, has_imu=has_imu)
        packets = cost(size)
        if budget.take(packets, now_s) and (has_imu or self._all.take(packets, now_s)):
            return True
        self.refused += 1
        return False

    def most(self, peer: str, since_s: float, now_s: float) -> float:
        """So many packets of a peer can be admitted that has sent more than that just before."""
        if self._has_imu(peer, since_s):
            return inf
        left = self._budget(peer, now_s, has_imu=False).left(now_s)
        return inf if left >= PACKETS_HZ else min(left, self._all.left(now_s))

    def admits_said(self, peer: str, frames: int, now_s: float) -> int:
        """How many are read of so many frames that one with an IMU says once: parameters."""
        budget = self._budget(peer, now_s, has_imu=True)
        admitted = min(frames, int(budget.left(now_s)))
        budget.take(admitted, now_s)
        self.refused += frames - admitted
        return admitted

    def _has_imu(self, peer: str, since_s: float) -> bool:
        return self._until_s.get(peer, 0.0) > since_s

    def _budget(self, peer: str, now_s: float, *, has_imu: bool) -> _Budget:
        budget = self._budgets.get((peer, has_imu))
        if budget is None:
            if len(self._budgets) >= MOST_PEERS:
                self._budgets.clear()  # the budget of all still holds
            rate_hz = IMU_PACKETS_HZ if has_imu else PACKETS_HZ
            budget = self._budgets[peer, has_imu] = _Budget(rate_hz, now_s)
        return budget

    def left_s(self, peer: str, now_s: float) -> float:
        """For how long the claim of ``peer`` still holds."""
        return max(0.0, self._until_s.get(peer, 0.0) - now_s)

    def is_aging(self, peer: str, now_s: float) -> bool:
        """Whether it is time that an IMU sample of ``peer`` is noted again."""
        return self._until_s.get(peer, 0.0) <= now_s + 0.5 * CLAIM_S

    def note(self, peer: str, messages: Iterable[int], now_s: float) -> None:
        """Frames of ``peer`` were let in, of these messages."""
        if not self.is_aging(peer, now_s):
            return
        if any(number in IMU_MESSAGES for number in messages):
            if len(self._until_s) >= MOST_PEERS:
                self._until_s = {k: s for k, s in self._until_s.items() if s > now_s}
            self._until_s[peer] = now_s + CLAIM_S
