# ruff: noqa: D102 - what each method does is written once, at Transport
"""UDP: listening on a port, or sending to an address first."""

import errno
import selectors
import socket
from collections import OrderedDict
from typing import Any

from drivers.endpoint import Endpoint
from drivers.mavlink.transports.sockets import (
    RECEIVE_BYTES,
    listening_socket,
    local_address,
    new_socket,
    reason,
    resolve,
)
from drivers.mavlink.transports.transport import LinkError, Packet

# Reads in one call before the owner gets them: a flood cannot keep it from anything else
RECEIVE_READS = 256
# Senders to answer on one UDP port; the one silent for longest is forgotten first
MOST_UDP_PEERS = 32
# A datagram that could not be delivered is like a lost one
LOST_DATAGRAM = (errno.ECONNREFUSED, errno.ENOBUFS, errno.EMSGSIZE, errno.ECONNRESET)


class UdpIn:
    """Listens on a UDP port and answers whoever has sent something."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._socket: _UdpSocket | None = None
        self._peers: OrderedDict[Any, str] = OrderedDict()  # names by address

    @property
    def connected(self) -> bool:
        return self._socket is not None

    @property
    def address(self) -> str:
        bound = None if self._socket is None else self._socket.socket
        return local_address("udpin", bound) or str(self._endpoint)

    def open(self) -> None:
        self._socket = _UdpSocket(listening_socket(self._endpoint, socket.SOCK_DGRAM))

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        datagrams = self._socket.receive(timeout_s)
        return [Packet(self._peer(sender), data) for data, sender in datagrams]

    def send(self, data: bytes) -> None:
        assert self._socket is not None
        for sender in self._peers:
            self._socket.send(data, sender)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._peers.clear()

    def _peer(self, sender: Any) -> str:
        """The name of a sender, who is remembered."""
        name = self._peers.get(sender)
        if name is None:
            name = self._peers[sender] = f"{sender[0]}:{sender[1]}"
            if len(self._peers) > MOST_UDP_PEERS:
                self._peers.popitem(last=False)
        else:
            self._peers.move_to_end(sender)
        return name


class UdpOut:
    """Sends to one UDP address and takes what that host sends back."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._socket: _UdpSocket | None = None
        self._target: Any = None

    @property
    def connected(self) -> bool:
        return self._socket is not None

    @property
    def address(self) -> str:
        return str(self._endpoint)

    def open(self) -> None:
        family, self._target = resolve(self._endpoint, socket.SOCK_DGRAM)
        self._socket = _UdpSocket(new_socket(family, socket.SOCK_DGRAM))

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        return [
            Packet(f"{sender[0]}:{sender[1]}", data)
            for data, sender in self._socket.receive(timeout_s)
            if sender[0] == self._target[0]
        ]

    def send(self, data: bytes) -> None:
        assert self._socket is not None
        self._socket.send(data, self._target)

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None


class _UdpSocket:
    """A UDP socket with a selector of its own: to make one takes as long as eight datagrams."""

    def __init__(self, created: socket.socket) -> None:
        self.socket = created
        self._selector = selectors.DefaultSelector()
        self._selector.register(created, selectors.EVENT_READ)

    def receive(self, timeout_s: float) -> list[tuple[bytes, Any]]:
        """Data and sender of all datagrams that are there, after at most ``timeout_s``.

        Raises:
            LinkError: the socket broke.
        """
        self._selector.select(max(0.0, timeout_s))
        datagrams: list[tuple[bytes, Any]] = []
        while len(datagrams) < RECEIVE_READS:
            try:
                datagrams.append(self.socket.recvfrom(RECEIVE_BYTES))
            except (BlockingIOError, InterruptedError):
                break
            except OSError as error:
                if error.errno in LOST_DATAGRAM:
                    continue
                raise LinkError(reason(error.errno)) from error
        return datagrams

    def send(self, data: bytes, target: Any) -> None:
        """Send a datagram, or lose it.

        Raises:
            LinkError: the socket broke.
        """
        try:
            self.socket.sendto(data, target)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            if error.errno not in LOST_DATAGRAM:
                raise LinkError(reason(error.errno)) from error

    def close(self) -> None:
        """Release both."""
        self._selector.close()
        self.socket.close()
