"""Rate limits of a link's senders: whose packets are read when more come than can be.

A flood of heartbeats costs as much to read as samples do. So each peer without an IMU has a budget
of packets a second, and all of them together have one. A peer that sends IMU data has a larger
budget of its own, so that nobody else's flood keeps its samples out.
"""

PACKETS_HZ = 200.0  # of a peer without an IMU; a ground station sends a tenth of that
ALL_PACKETS_HZ = 2000.0  # of all those together
IMU_PACKETS_HZ = 30_000.0  # of a peer with an IMU; a router may forward 200 vehicles
IMU_COUNTS_S = 5.0  # a peer counts as one with an IMU for so long after a sample
FRAME_BYTES = 64  # of a usual frame: a packet that is larger counts as several
MOST_PEERS = 1024


class _TokenBucket:
    """A second's worth of packets, refilled as time goes by."""

    __slots__ = ("_at_s", "_left", "_rate_hz")

    def __init__(self, rate_hz: float, now_s: float) -> None:
        self._rate_hz = self._left = rate_hz
        self._at_s = now_s

    def take(self, packets: int, now_s: float) -> bool:
        """Whether there are so many left, which are then taken; a full bucket is enough for any."""
        left = self._left + self._rate_hz * max(0.0, now_s - self._at_s)  # the clock may be set
        self._left, self._at_s = min(self._rate_hz, left), now_s
        packets = min(packets, int(self._rate_hz))
        if self._left < packets:
            return False
        self._left -= packets
        return True


class _Peer:
    """One peer's budgets, and when it last sent IMU data."""

    __slots__ = ("imu_s", "others", "with_imu")

    def __init__(self, now_s: float) -> None:
        self.imu_s = now_s - IMU_COUNTS_S
        self.others = _TokenBucket(PACKETS_HZ, now_s)
        self.with_imu = _TokenBucket(IMU_PACKETS_HZ, now_s)


class RateLimits:
    """Tells whether a peer's packet is read; ``refused`` counts those that are not.

    Times are those of the packets' arrival, in s: nobody is refused because this process has not
    looked for a while.
    """

    def __init__(self) -> None:
        self.refused = 0
        self._peers: dict[str, _Peer] = {}
        self._all = _TokenBucket(ALL_PACKETS_HZ, 0.0)

    def admits(self, peer: str, size: int, now_s: float) -> bool:
        """Whether a packet of ``size`` bytes is read that arrived at ``now_s``."""
        known = self._peers.get(peer)
        if known is None:
            if len(self._peers) >= MOST_PEERS:
                self._drop_idle(now_s)
            known = self._peers[peer] = _Peer(now_s)
        packets = 1 + size // FRAME_BYTES
        if now_s - known.imu_s < IMU_COUNTS_S:
            is_admitted = known.with_imu.take(packets, now_s)
        else:
            is_admitted = known.others.take(packets, now_s) and self._all.take(packets, now_s)
        self.refused += not is_admitted
        return is_admitted

    def note_imu(self, peer: str, now_s: float) -> None:
        """IMU data of ``peer`` was let in."""
        known = self._peers.get(peer)
        if known is not None:
            known.imu_s = now_s

    def _drop_idle(self, now_s: float) -> None:
        """Forget who sends no IMU data; the budget of all of them still holds."""
        self._peers = {
            peer: known for peer, known in self._peers.items() if now_s - known.imu_s < IMU_COUNTS_S
        }
