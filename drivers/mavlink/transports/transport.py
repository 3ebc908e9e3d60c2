"""Bytes over UDP, TCP or a serial line, for the link and for the simulated vehicle alike.

A transport is used by one thread only. ``receive`` is the only call that
waits. What a person got wrong (a taken port, a missing device, an unknown
host) raises :class:`~estimator.errors.InputError` from ``open``; what may come
back by itself raises :class:`LinkError`, after which the owner closes the
transport and opens it again.
"""

import time
from abc import ABC, abstractmethod
from typing import NamedTuple

from drivers.endpoint import Endpoint


def unix_us() -> int:
    """Now, by the host's clock, in Unix microseconds."""
    return time.time_ns() // 1000


class LinkError(OSError):
    """Raised when a link broke or could not be made yet; the message is the reason."""


class Packet(NamedTuple):
    """Bytes from one peer; no bytes at all mean that the peer has left.

    ``arrival_us`` is when the system received them (Unix time).
    """

    peer: str
    data: bytes
    arrival_us: int


class Transport(ABC):
    """What the link and the simulated vehicle need from a socket or a serial line."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether bytes can come in."""

    @property
    def address(self) -> str:
        """The address in use, once open."""
        return str(self._endpoint)

    @property
    def lost(self) -> int:
        """Datagrams that the system has thrown away since ``open``, for want of room."""
        return 0  # of a stream: what the system has taken it also gives

    @abstractmethod
    def open(self) -> None:
        """Bind, begin to connect, or open the device.

        Raises:
            InputError: a port is taken, a device is missing, a host unknown.
            LinkError: it may work later.
        """

    @abstractmethod
    def receive(self, timeout_s: float) -> list[Packet]:
        """What has arrived, after at most ``timeout_s``.

        Raises:
            LinkError: the link broke.
        """

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send whole frames to every peer; what cannot be sent now may be dropped.

        Raises:
            LinkError: the link broke.
        """

    def credit(self, peer: str) -> None:  # noqa: B027 - most have as many places as peers
        """An IMU's frames have come from a peer: whoever sends them keeps a place."""

    @abstractmethod
    def close(self) -> None:
        """Release everything; the transport can be opened again."""
