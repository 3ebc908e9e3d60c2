# ruff: noqa: D102 - what each method does is written once, at Transport
"""Bytes over UDP, TCP or a serial line, for the link and for the simulated vehicle alike.

A transport is used by one thread only. ``receive`` is the only call that
waits. What a person got wrong (a taken port, a missing device, an unknown
host) raises :class:`~estimator.errors.InputError` from ``open``; what may come
back by itself raises :class:`LinkError`, after which the owner closes the
transport and opens it again.
"""

import contextlib
import errno
import os
import selectors
import socket
import time
from collections import OrderedDict
from typing import Any, NamedTuple, Protocol

from drivers.endpoint import Endpoint
from estimator.errors import InputError

RECEIVE_BYTES = 65536
# Reads in one call before the owner gets them: a flood cannot keep it from anything else
RECEIVE_READS = 256
# 4 MB hold what 200 vehicles send in half a second; the kernel may grant less
SOCKET_BUFFER_BYTES = 4 * 1024 * 1024
# Senders to answer on one UDP port; the one silent for longest is forgotten first
MOST_UDP_PEERS = 32
MOST_TCP_CLIENTS = 32
# Bytes that wait for a slow TCP peer or serial line; when it is full, new frames are dropped
MOST_UNSENT_BYTES = 256 * 1024
MOST_UNSENT_SERIAL_BYTES = 2048
CONNECT_TIMEOUT_S = 5.0
# A TCP peer that lost power says nothing: probe after 5 s, give up 6 s later
KEEPALIVE_OPTIONS = (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3))
# A datagram that could not be delivered is like a lost one
LOST_DATAGRAM = (errno.ECONNREFUSED, errno.ENOBUFS, errno.EMSGSIZE, errno.ECONNRESET)


class LinkError(OSError):
    """Raised when a link broke or could not be made yet; the message is the reason."""


class Packet(NamedTuple):
    """Bytes from one peer; no bytes at all mean that the peer has left."""

    peer: str
    data: bytes


class Transport(Protocol):
    """What the link and the simulated vehicle need from a socket or a serial line."""

    @property
    def connected(self) -> bool:
        """Whether bytes can come in."""

    @property
    def address(self) -> str:
        """The address in use, once open."""

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

    def send(self, data: bytes) -> None:
        """Send whole frames to every peer; what cannot be sent now may be dropped.

        Raises:
            LinkError: the link broke.
        """

    def close(self) -> None:
        """Release everything; the transport can be opened again."""


def open_transport(endpoint: Endpoint) -> Transport:
    """The transport for a socket or serial endpoint, not yet open.

    Raises:
        InputError: the endpoint is neither.
    """
    match endpoint.kind:
        case "udpin":
            return UdpIn(endpoint)
        case "udpout":
            return UdpOut(endpoint)
        case "tcp":
            return TcpClient(endpoint)
        case "tcpin":
            return TcpServer(endpoint)
        case "serial":
            return SerialLine(endpoint)
        case _:
            raise InputError(f"{endpoint} is no MAVLink link: use udpin, udpout, tcp or tcpin")


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
        return _local_address("udpin", bound) or str(self._endpoint)

    def open(self) -> None:
        self._socket = _UdpSocket(_bound(self._endpoint, socket.SOCK_DGRAM))

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
        family, self._target = _resolved(self._endpoint, socket.SOCK_DGRAM)
        self._socket = _UdpSocket(_new_socket(family, socket.SOCK_DGRAM))

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


class TcpClient:
    """Connects to a TCP server."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._socket: socket.socket | None = None
        self._stream: _Stream | None = None
        self._deadline_s = 0.0

    @property
    def connected(self) -> bool:
        return self._stream is not None

    @property
    def address(self) -> str:
        return str(self._endpoint)

    def open(self) -> None:
        family, target = _resolved(self._endpoint, socket.SOCK_STREAM)
        self._socket = _new_socket(family, socket.SOCK_STREAM)
        self._deadline_s = time.monotonic() + CONNECT_TIMEOUT_S
        status = self._socket.connect_ex(target)
        if status not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            raise LinkError(_reason(status))

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        if self._stream is None:
            self._connect(timeout_s)
            return []
        _wait([self._socket], timeout_s, writable=self._stream.unsent)
        data = self._stream.receive()
        if data == b"":
            raise LinkError("closed by the other side")
        return [Packet(str(self._endpoint), data)] if data else []

    def send(self, data: bytes) -> None:
        if self._stream is not None:
            self._stream.send(data)

    def close(self) -> None:
        _close(self._socket)
        self._socket = self._stream = None

    def _connect(self, timeout_s: float) -> None:
        assert self._socket is not None
        if not _wait([self._socket], timeout_s, writable=True):
            if time.monotonic() > self._deadline_s:
                raise LinkError("no answer to the connection request")
            return
        status = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if status:
            raise LinkError(_reason(status))
        self._stream = _Stream(self._socket)


class TcpServer:
    """Accepts TCP clients, several at once."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._socket: socket.socket | None = None
        self._clients: dict[str, _Stream] = {}

    @property
    def connected(self) -> bool:
        return bool(self._clients)

    @property
    def address(self) -> str:
        return _local_address("tcpin", self._socket) or str(self._endpoint)

    def open(self) -> None:
        self._socket = _bound(self._endpoint, socket.SOCK_STREAM)
        self._socket.listen(MOST_TCP_CLIENTS)

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        _wait([self._socket, *(client.socket for client in self._clients.values())], timeout_s)
        self._accept(self._socket)
        packets = []
        for name, client in list(self._clients.items()):
            data = self._read(name, client)
            if data is not None:
                packets.append(Packet(name, data))
        return packets

    def send(self, data: bytes) -> None:
        for client in self._clients.values():
            # the reader notices a broken client
            with contextlib.suppress(LinkError):
                client.send(data)

    def close(self) -> None:
        for client in self._clients.values():
            client.socket.close()
        self._clients.clear()
        _close(self._socket)
        self._socket = None

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                accepted, sender = listener.accept()
            except OSError:  # nobody there, or gone again
                return
            if len(self._clients) >= MOST_TCP_CLIENTS:
                accepted.close()
                continue
            accepted.setblocking(False)
            self._clients[f"{sender[0]}:{sender[1]}"] = _Stream(accepted)

    def _read(self, name: str, client: "_Stream") -> bytes | None:
        try:
            data = client.receive()
        except LinkError:
            data = b""
        if data == b"":
            client.socket.close()
            del self._clients[name]
        return data


class SerialLine:
    """A serial device at a fixed baud rate, for us alone."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._port: Any = None

    @property
    def connected(self) -> bool:
        return self._port is not None

    @property
    def address(self) -> str:
        return str(self._endpoint)

    def open(self) -> None:
        import serial

        path, baud = self._endpoint.path, self._endpoint.baud
        try:
            # a second reader would steal half the bytes
            options = {"exclusive": True} if os.name == "posix" else {}
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=0, **options)
        except (OSError, ValueError) as error:
            raise InputError(
                f"cannot open serial device {path}: {_serial_reason(error)}"
            ) from error

    def receive(self, timeout_s: float) -> list[Packet]:
        try:
            self._port.timeout = timeout_s
            data = self._port.read(1)
            data += self._port.read(min(self._port.in_waiting, RECEIVE_BYTES))
        except (OSError, TypeError) as error:  # TypeError: pyserial, closed while reading
            raise LinkError(_serial_reason(error)) from error
        return [Packet(str(self._endpoint), bytes(data))] if data else []

    def send(self, data: bytes) -> None:
        try:
            if self._port.out_waiting + len(data) <= MOST_UNSENT_SERIAL_BYTES:
                self._port.write(data)
        except OSError as error:
            raise LinkError(_serial_reason(error)) from error

    def close(self) -> None:
        if self._port is not None:
            with contextlib.suppress(OSError):
                self._port.close()
            self._port = None


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
                raise LinkError(_reason(error.errno)) from error
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
                raise LinkError(_reason(error.errno)) from error

    def close(self) -> None:
        """Release both."""
        self._selector.close()
        self.socket.close()


class _Stream:
    """A connected TCP socket that never sends half a frame."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        self._unsent = bytearray()
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE_OPTIONS:
            if hasattr(socket, name):
                connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    @property
    def unsent(self) -> bool:
        return bool(self._unsent)

    def receive(self) -> bytes | None:
        """Bytes, None if there are none yet, or b"" if the other side has closed.

        Raises:
            LinkError: the connection broke.
        """
        self.send(b"")
        try:
            return self.socket.recv(RECEIVE_BYTES)
        except (BlockingIOError, InterruptedError):
            return None
        except OSError as error:
            raise LinkError(_reason(error.errno)) from error

    def send(self, data: bytes) -> None:
        if len(self._unsent) + len(data) <= MOST_UNSENT_BYTES:
            self._unsent += data
        if not self._unsent:
            return
        try:
            del self._unsent[: self.socket.send(self._unsent)]
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            raise LinkError(_reason(error.errno)) from error


def _new_socket(family: int, kind: int) -> socket.socket:
    created = socket.socket(family, kind)
    created.setblocking(False)
    created.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SOCKET_BUFFER_BYTES)
    return created


def _resolved(endpoint: Endpoint, kind: int) -> tuple[int, Any]:
    try:
        found = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or "no such host"
        raise InputError(f"{endpoint}: cannot find host {endpoint.host!r} ({reason})") from error
    # localhost may mean both; nearly every MAVLink program listens on IPv4
    found.sort(key=lambda entry: entry[0] != socket.AF_INET)
    return found[0][0], found[0][4]


def _bound(endpoint: Endpoint, kind: int) -> socket.socket:
    family, local = _resolved(endpoint, kind)
    created = _new_socket(family, kind)
    try:
        if kind == socket.SOCK_STREAM and os.name == "posix":
            # a port whose last connection has just closed is not taken
            created.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        created.bind(local)
    except OSError as error:
        created.close()
        raise InputError(f"cannot listen on {endpoint}: {_reason(error.errno)}") from error
    return created


def _wait(sockets: list[socket.socket], timeout_s: float, *, writable: bool = False) -> bool:
    """Whether any socket can be read (or, if asked, written) within the time."""
    with selectors.DefaultSelector() as selector:
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if writable else 0)
        for each in sockets:
            selector.register(each, wanted)
        return bool(selector.select(max(0.0, timeout_s)))


def _close(used: socket.socket | None) -> None:
    if used is not None:
        used.close()


def _local_address(kind: str, bound: socket.socket | None) -> str | None:
    if bound is None:
        return None
    host, port = bound.getsockname()[:2]
    return f"{kind}:[{host}]:{port}" if ":" in host else f"{kind}:{host}:{port}"


def _reason(number: int | None) -> str:
    return os.strerror(number) if number else "unknown error"


def _serial_reason(error: BaseException) -> str:
    number = getattr(error, "errno", None)
    if "Could not configure port" in str(error):  # pyserial's words; the system's are in brackets
        return "not a serial device"
    if number in (errno.EAGAIN, errno.EACCES) and "lock" in str(error):
        return "in use by another program"
    return _reason(number) if number else str(error)
