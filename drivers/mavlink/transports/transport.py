"""Bytes over UDP, TCP or a serial line, for the link and for the simulated vehicle alike.

A transport is used by one thread only. ``receive`` is the only call that
waits. What a person got wrong (a taken port, a missing device, an unknown
host) raises :class:`~estimator.errors.InputError` from ``open``; what may come
back by itself raises ``OSError``, after which the owner closes the transport
and opens it again. Below it: what UDP and TCP have in common.
"""

import errno
import os
import socket
import sys
import time
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, NamedTuple

from drivers.endpoint import Endpoint
from estimator.errors import InputError


def unix_us() -> int:
    """Now, by the host's clock, in Unix microseconds."""
    return time.time_ns() // 1000


class Packet(NamedTuple):
    """Bytes from one peer; no bytes at all mean that the peer has left.

    ``arrival_us`` is when the system received them (Unix time).
    """

    peer: str
    data: bytes
    arrival_us: int


class Transport(ABC):
    """What the link and the simulated vehicle need from a socket or a serial line."""

    _socket: socket.socket | None = None  # None: closed, or no socket

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint

    @property
    def connected(self) -> bool:
        """Whether bytes can come in, once it is open."""
        return True

    @property
    def address(self) -> str:
        """The address in use, once open, with the real port where 0 is bound."""
        if self._socket is None or self._endpoint.kind not in ("udpin", "tcpin"):
            return str(self._endpoint)
        host, port = self._socket.getsockname()[:2]
        return str(replace(self._endpoint, host=host, port=port))

    @property
    def lost(self) -> int:
        """Datagrams that the system has thrown away since ``open``, for want of room."""
        return 0  # of a stream: what the system has taken it also gives

    @abstractmethod
    def open(self) -> None:
        """Bind, begin to connect, or open the device.

        Raises:
            InputError: a port is taken, a device is missing, a host unknown.
            OSError: it may work later.
        """

    @abstractmethod
    def receive(self, timeout_s: float) -> list[Packet]:
        """What has arrived, after at most ``timeout_s``.

        Raises:
            OSError: the link broke.
        """

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send whole frames to every peer; what cannot be sent now may be dropped.

        Raises:
            OSError: the link broke.
        """

    def close(self) -> None:
        """Release everything; the transport can be opened again."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None


RECEIVE_BYTES = 65536
# Linux shows with each datagram when it arrived, which may be long before it is read (socket(7)).
# Python has no name for this number, which is that of all processors but a few old ones.
IS_LINUX = sys.platform == "linux"
SO_TIMESTAMPNS = 35
# 4 MB hold what 200 vehicles send in half a second; the kernel may grant less
SOCKET_BUFFER_BYTES = 4 * 1024 * 1024


def new_socket(family: int, kind: int) -> socket.socket:
    """A socket that never waits, with room for a burst."""
    created = socket.socket(family, kind)
    created.setblocking(False)
    created.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER_BYTES)
    if IS_LINUX and kind == socket.SOCK_DGRAM:
        created.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    return created


def resolve(endpoint: Endpoint, kind: int) -> tuple[int, Any]:
    """Address family and socket address of the endpoint's host.

    Raises:
        InputError: there is no such host.
    """
    try:
        found = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "no such host"
        raise InputError(f"{endpoint}: cannot find host {endpoint.host!r} ({reason})") from error
    # localhost may mean both; nearly every MAVLink program listens on IPv4
    found.sort(key=lambda entry: entry[0] != socket.AF_INET)
    return found[0][0], found[0][4]


def listening_socket(endpoint: Endpoint, kind: int) -> socket.socket:
    """A socket bound to the endpoint's address.

    Raises:
        InputError: the port is taken, or the address is not this computer's.
    """
    family, local = resolve(endpoint, kind)
    created = new_socket(family, kind)
    try:
        if kind == socket.SOCK_STREAM and os.name == "posix":
            # a port whose last connection has just closed is not taken
            created.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        created.bind(local)
    except OSError as error:
        created.close()
        what = f"cannot listen on {endpoint}: {error.strerror}"
        raise InputError(what + _way_out(endpoint, error.errno)) from error
    return created


def _way_out(endpoint: Endpoint, number: int | None) -> str:
    """What to do about a port that cannot be had, to stand behind the reason."""
    if number == errno.EADDRINUSE:
        tool = f"ss -{'u' if endpoint.kind == 'udpin' else 't'}lpn sport = :{endpoint.port}"
        return f" (a ground station has it? {tool} names the program; or choose another port)"
    if number == errno.EADDRNOTAVAIL:
        return " (no address of this computer; 0.0.0.0 listens on all of them)"
    if number == errno.EACCES:
        return " (ports below 1024 are for root; choose a higher one)"
    return ""
