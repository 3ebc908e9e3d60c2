"""Bytes over UDP, TCP or a serial line, for the link and for the simulated vehicle alike.

A transport is used by one thread only. ``receive`` is the only call that
waits. What a person got wrong (a taken port, a missing device, an unknown
host) raises :class:`~estimator.errors.InputError` from ``open``; what may come
back by itself raises :class:`LinkError`, after which the owner closes the
transport and opens it again.
"""

from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    from drivers.mavlink.transports.datagrams import Datagrams


class LinkError(OSError):
    """Raised when a link broke or could not be made yet; the message is the reason."""


class Packet(NamedTuple):
    """Bytes from one peer; no bytes at all mean that the peer has left.

    ``arrival_us`` is when the system received them (Unix time), 0 where it does not tell.
    """

    peer: str
    data: bytes
    arrival_us: int = 0


class Transport(Protocol):
    """What the link and the simulated vehicle need from a socket or a serial line."""

    @property
    def connected(self) -> bool:
        """Whether bytes can come in."""

    @property
    def address(self) -> str:
        """The address in use, once open."""

    @property
    def stamps_arrivals(self) -> bool:
        """Whether the system notes when bytes arrive, so that they may wait to be received."""

    @property
    def lost(self) -> int:
        """Datagrams that the system has thrown away since ``open``, for want of room."""

    def open(self) -> None:
        """Bind, begin to connect, or open the device.

        Raises:
            InputError: a port is taken, a device is missing, a host unknown.
            LinkError: it may work later.
        """

    def receive(self, timeout_s: float) -> list[Packet]:
        """What has arrived, after at most ``timeout_s``.

        Raises:
            LinkError: the link broke.
        """

    def receive_many(self, timeout_s: float) -> "Datagrams":
        """The same as one piece of memory; good until the next call."""

    def send(self, data: bytes) -> None:
        """Send whole frames to every peer; what cannot be sent now may be dropped.

        Raises:
            LinkError: the link broke.
        """

    def credit(self, peer: str) -> None:
        """An IMU's frames have come from a peer: whoever sends them keeps a place."""

    def close(self) -> None:
        """Release everything; the transport can be opened again."""
