"""Whose bytes are worth reading when more come than can be: first those who send IMU data.

A flood of heartbeats costs as much to read as samples do, and none of it is wanted so often. A peer
without an IMU has a budget of packets a second, and all of them together have one.
"""

from collections.abc import Iterable

from drivers.mavlink.imu_messages import IMU_MESSAGES

PACKETS_HZ = 200.0  # of a peer without an IMU: a ground station sends a tenth of that
ALL_PACKETS_HZ = 2000.0  # of all those together
CLAIM_S = 5.0  # for so long an IMU sample counts
MOST_PEERS = 1024


class _Budget:
    """A second's worth of packets, refilled as time goes."""

    def __init__(self, rate_hz: float, now_s: float) -> None:
        self._rate_hz = self._left = rate_hz
        self._at_s = now_s

    def take(self, now_s: float) -> bool:
        """Whether there is one left."""
        self._left = min(self._rate_hz, self._left + self._rate_hz * (now_s - self._at_s))
        self._at_s = now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class Claims:
    """Tells whether a peer's packet is to be read; ``refused`` counts those that are not."""

    def __init__(self) -> None:
        self.refused = 0
        self._until_s: dict[str, float] = {}  # those with an IMU
        self._budgets: dict[str, _Budget] = {}
        self._all = _Budget(ALL_PACKETS_HZ, 0.0)

    def admits(self, peer: str, since_s: float, now_s: float) -> bool:
        """Whether a packet of ``peer`` is read that has come ``since_s``, when all before was.

        Nobody's claim ends because nobody has looked.
        """
        if self._until_s.get(peer, 0.0) > since_s:
            return True
        budget = self._budgets.get(peer)
        if budget is None:
            if len(self._budgets) >= MOST_PEERS:
                self._budgets.clear()  # the budget of all still holds
            budget = self._budgets[peer] = _Budget(PACKETS_HZ, now_s)
        if budget.take(now_s) and self._all.take(now_s):
            return True
        self.refused += 1
        return False

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
