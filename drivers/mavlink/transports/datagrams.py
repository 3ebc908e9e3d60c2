"""Many packets, one behind the other in one piece of memory, as compiled code reads them."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import numpy as np

from drivers.mavlink.transports.transport import Packet

Array = Any  # numba ships no types
LARGEST_PEER = (1 << 62) - 1


class Datagrams(NamedTuple):
    """Packet k is ``data[begins[k]:ends[k]]``, from ``peers[k]``, arrived at ``arrivals_us[k]``.

    ``data`` are uint8, all others int64. ``name_of`` makes a peer's name of its number.
    """

    data: Array
    begins: Array
    ends: Array
    peers: Array
    arrivals_us: Array
    name_of: Callable[[int], str]

    @classmethod
    def of(cls, packets: Sequence[Packet], now_us: int) -> Self:
        """The packets; those without a time have arrived at ``now_us``."""
        names = {peer_number(packet.peer): packet.peer for packet in packets}
        n = len(packets)
        bounds = np.zeros(n + 1, np.int64)
        np.cumsum(np.fromiter((len(each.data) for each in packets), np.int64, n), out=bounds[1:])
        return cls(
            np.frombuffer(b"".join([each.data for each in packets]), np.uint8),
            bounds[:-1],
            bounds[1:],
            np.fromiter((peer_number(each.peer) for each in packets), np.int64, n),
            np.fromiter((each.arrival_us or now_us for each in packets), np.int64, n),
            names.__getitem__,
        )

    @property
    def number(self) -> int:
        """How many there are."""
        return len(self.peers)

    def packet(self, k: int) -> Packet:
        """One packet."""
        data = self.data[self.begins[k] : self.ends[k]].tobytes()
        return Packet(self.name_of(int(self.peers[k])), data, int(self.arrivals_us[k]))

    def kept(self, which: Array) -> Self:
        """Those of which an array says so."""
        numbers = (self.begins, self.ends, self.peers, self.arrivals_us)
        begins, ends, peers, arrivals_us = (each[which] for each in numbers)
        return type(self)(self.data, begins, ends, peers, arrivals_us, self.name_of)


def unix_us() -> int:
    """Now, by the host's clock."""
    return time.time_ns() // 1000


def peer_number(name: str) -> int:
    """A peer's number, the same for the whole life of this process and no other."""
    return hash(name) & LARGEST_PEER
