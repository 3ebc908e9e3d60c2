# ruff: noqa: D102 - what each method does is written once, at Transport
"""TCP: connecting to a server, or being one for several clients."""

import contextlib
import errno
import logging
import os
import selectors
import socket
import time
from collections import Counter
from math import inf

from drivers.endpoint import Endpoint
from drivers.mavlink.transports import transport
from drivers.mavlink.transports.transport import Packet, Transport, unix_us

_logger = logging.getLogger(__name__)

MOST_TCP_CLIENTS = 32
# Bytes that wait for a slow peer; when it is full, new frames are dropped
MOST_UNSENT_BYTES = 256 * 1024
CONNECT_TIMEOUT_S = 5.0
LONG_SILENCE_S = 5.0  # then an IMU's client gives way to a new one, too
NO_DESCRIPTORS = (errno.EMFILE, errno.ENFILE)
NO_DESCRIPTORS_REST_S = 0.05
WARN_S = 60.0
# A peer that lost power sends nothing: probe after 5 s, give up 6 s later
KEEPALIVE_OPTIONS = (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3))


class TcpClient(Transport):
    """Connects to a TCP server."""

    _stream: "_Stream | None" = None  # None: not connected
    _deadline_s = 0.0

    @property
    def connected(self) -> bool:
        return self._stream is not None

    def open(self) -> None:
        family, target = transport.resolve(self._endpoint, socket.SOCK_STREAM)
        self._socket = transport.new_socket(family, socket.SOCK_STREAM)
        self._deadline_s = time.monotonic() + CONNECT_TIMEOUT_S
        with contextlib.suppress(BlockingIOError):  # it goes on connecting
            self._socket.connect(target)

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        if self._stream is None:
            self._connect(self._socket, timeout_s)
            return []
        _wait([self._socket], timeout_s, writable=bool(self._stream.unsent))
        data = self._stream.receive()
        return [Packet(str(self._endpoint), data, unix_us())] if data else []

    def send(self, data: bytes) -> None:
        if self._stream is not None:
            self._stream.send(data)

    def close(self) -> None:
        super().close()
        self._stream = None

    def _connect(self, connecting: socket.socket, timeout_s: float) -> None:
        if not _wait([connecting], timeout_s, writable=True):
            if time.monotonic() > self._deadline_s:
                raise ConnectionError("no answer to the connection request")
            return
        status = connecting.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if status:
            raise OSError(status, os.strerror(status))
        self._stream = _Stream(connecting)


class TcpServer(Transport):
    """Accepts TCP clients, several at once."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._clients: dict[str, _Stream] = {}
        self._warn_due_s = 0.0

    @property
    def connected(self) -> bool:
        return bool(self._clients)

    def open(self) -> None:
        self._socket = transport.listening_socket(self._endpoint, socket.SOCK_STREAM)
        self._socket.listen(MOST_TCP_CLIENTS)

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        _wait([self._socket, *(client.socket for client in self._clients.values())], timeout_s)
        self._accept(self._socket)
        packets = []
        for name, client in list(self._clients.items()):
            try:
                data = client.receive()
            except OSError:
                data = b""  # it has left
                self._drop(name)
            if data is not None:
                packets.append(Packet(name, data, unix_us()))
        return packets

    def send(self, data: bytes) -> None:
        for client in self._clients.values():
            # the reader notices a broken client
            with contextlib.suppress(OSError):
                client.send(data)

    def credit(self, peer: str) -> None:
        """An IMU's frames have come from a peer, which therefore keeps its slot."""
        if peer in self._clients:
            self._clients[peer].imu_s = time.monotonic()

    def close(self) -> None:
        for name in list(self._clients):
            self._drop(name)
        super().close()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                accepted, sender = listener.accept()
            except OSError as error:  # nobody there, or gone again
                if error.errno in NO_DESCRIPTORS:  # who waits makes every look end at once
                    self._warn(str(error.strerror))
                    time.sleep(NO_DESCRIPTORS_REST_S)
                return
            if len(self._clients) >= MOST_TCP_CLIENTS and not self._make_room(sender[0]):
                self._warn(f"{MOST_TCP_CLIENTS} clients are connected, no more are let in")
                accepted.close()
                continue
            accepted.setblocking(False)
            self._clients[f"{sender[0]}:{sender[1]}"] = _Stream(accepted)

    def _make_room(self, host: str) -> bool:
        """Drop a client without an IMU, or silent for long; or one of a host with most.

        One host must not keep others out, whatever it sends.
        """
        by_silence = sorted(self._clients, key=lambda name: self._clients[name].imu_s)
        name = by_silence[0]  # of those without an IMU, which come first, who connected first
        if time.monotonic() - self._clients[name].imu_s < LONG_SILENCE_S:
            hosts = {each: each.rpartition(":")[0] for each in by_silence}
            crowd, size = Counter(hosts.values()).most_common(1)[0]
            if crowd == host or size <= MOST_TCP_CLIENTS // 2:
                return False
            name = next(each for each in by_silence if hosts[each] == crowd)
        self._warn(
            f"{MOST_TCP_CLIENTS} clients are connected: {name}, silent for longest, is dropped"
        )
        self._drop(name)
        return True

    def _drop(self, name: str) -> None:
        self._clients.pop(name).socket.close()

    def _warn(self, text: str) -> None:
        """Log a line, once a minute at most: any client can cause it at will."""
        now_s = time.monotonic()
        if now_s >= self._warn_due_s:
            self._warn_due_s = now_s + WARN_S
            _logger.warning("%s: %s", self._endpoint, text)


class _Stream:
    """A connected TCP socket that never sends half a frame."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        self.unsent = bytearray()
        self.imu_s = -inf  # when it last sent IMU data: noise and chatter are not what we want
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for name, value in KEEPALIVE_OPTIONS:
            if hasattr(socket, name):
                connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def receive(self) -> bytes | None:
        """Bytes; None if there are none yet.

        Raises:
            OSError: the connection broke, or the other side has closed it.
        """
        self.send(b"")
        try:
            data = self.socket.recv(transport.RECEIVE_BYTES)
        except (BlockingIOError, InterruptedError):
            return None
        if not data:
            raise ConnectionError("closed by the other side")
        return data

    def send(self, data: bytes) -> None:
        if len(self.unsent) + len(data) <= MOST_UNSENT_BYTES:
            self.unsent += data
        if not self.unsent:
            return
        with contextlib.suppress(BlockingIOError, InterruptedError):
            del self.unsent[: self.socket.send(self.unsent)]


def _wait(sockets: list[socket.socket], timeout_s: float, *, writable: bool = False) -> bool:
    """Whether any socket can be read (or, if asked, written) within the time."""
    with selectors.DefaultSelector() as selector:
        wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if writable else 0)
        for each in sockets:
            selector.register(each, wanted)
        return bool(selector.select(max(0.0, timeout_s)))
