# ruff: noqa: D102 - what each method does is written once, at Transport
"""UDP: listening on a port, or sending to an address first."""

import errno
import socket
import sys
from collections import OrderedDict
from struct import Struct
from typing import Any

from drivers.endpoint import Endpoint
from drivers.mavlink.transports.transport import (
    RECEIVE_BYTES,
    Packet,
    Transport,
    listening_socket,
    new_socket,
    resolve,
    unix_us,
)

# Reads in one call before the owner gets them: a flood cannot keep it from anything else.
RECEIVE_READS = 2048
# Senders to answer on one UDP port; the one silent for longest is forgotten first
MOST_UDP_PEERS = 32
# A datagram that could not be delivered is like a lost one
LOST_DATAGRAM = (errno.ECONNREFUSED, errno.ENOBUFS, errno.EMSGSIZE, errno.ECONNRESET)

# Linux shows with each datagram when it arrived, which may be long before it is read
# (socket(7), SO_TIMESTAMPNS), and how many it has thrown away (SO_MEMINFO, linux/sock_diag.h).
# Python has no names for these numbers, which are those of all processors but a few old ones.
IS_LINUX = sys.platform == "linux"
SO_TIMESTAMPNS = 35
SO_MEMINFO = 55
TIMESPEC = Struct("@ll")  # s, ns
MEMINFO = Struct("@9I")
MEMINFO_DROPS = 8
ANCILLARY_BYTES = 64


class _Udp(Transport):
    """A UDP socket."""

    @property
    def lost(self) -> int:
        """Datagrams that the system has thrown away; to ask it takes as long as to read some."""
        if not IS_LINUX or self._socket is None:
            return 0
        info = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
        # old kernels show less
        return int(MEMINFO.unpack(info)[MEMINFO_DROPS]) if len(info) == MEMINFO.size else 0

    def _use(self, created: socket.socket) -> None:
        self._socket = created
        if IS_LINUX:
            created.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    def _datagrams(self, timeout_s: float) -> list[tuple[bytes, Any, int]]:
        """Data, sender and arrival of all datagrams that are there, after at most ``timeout_s``.

        One without a byte is left out: it ends no connection as in a stream.
        """
        assert self._socket is not None
        datagrams: list[tuple[bytes, Any, int]] = []
        own = self._socket
        own.settimeout(max(0.0, timeout_s))
        while len(datagrams) < RECEIVE_READS:
            try:
                datagrams.append(_read(own))
            except (BlockingIOError, InterruptedError, TimeoutError):
                break
            except OSError as error:
                if error.errno not in LOST_DATAGRAM:
                    raise
            if own.gettimeout():  # none but the first is waited for
                own.setblocking(False)
        own.setblocking(False)
        return [each for each in datagrams if each[0]]

    def _send(self, data: bytes, target: Any) -> None:
        """Send a datagram, or lose it."""
        assert self._socket is not None
        try:
            self._socket.sendto(data, target)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            if error.errno not in LOST_DATAGRAM:
                raise


class UdpIn(_Udp):
    """Listens on a UDP port and answers whoever has sent something."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._peers: OrderedDict[Any, str] = OrderedDict()  # names by address

    def open(self) -> None:
        self._peers.clear()
        self._use(listening_socket(self._endpoint, socket.SOCK_DGRAM))

    def receive(self, timeout_s: float) -> list[Packet]:
        datagrams = self._datagrams(timeout_s)
        return [Packet(self._peer(sender), data, us) for data, sender, us in datagrams]

    def send(self, data: bytes) -> None:
        for sender in self._peers:
            self._send(data, sender)

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


class UdpOut(_Udp):
    """Sends to one UDP address and takes what that host sends back."""

    _target: Any = None

    def open(self) -> None:
        family, self._target = resolve(self._endpoint, socket.SOCK_DGRAM)
        self._use(new_socket(family, socket.SOCK_DGRAM))

    def receive(self, timeout_s: float) -> list[Packet]:
        return [
            Packet(f"{sender[0]}:{sender[1]}", data, us)
            for data, sender, us in self._datagrams(timeout_s)
            if sender[0] == self._target[0]
        ]

    def send(self, data: bytes) -> None:
        self._send(data, self._target)


def _read(own: socket.socket) -> tuple[bytes, Any, int]:
    if not IS_LINUX:
        return (*own.recvfrom(RECEIVE_BYTES), unix_us())
    data, ancillary, _flags, sender = own.recvmsg(RECEIVE_BYTES, ANCILLARY_BYTES)
    if len(ancillary) == 1:
        ((level, kind, stamp),) = ancillary
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(stamp) == TIMESPEC.size:
            s, ns = TIMESPEC.unpack(stamp)
            return data, sender, s * 1_000_000 + ns // 1000
    return data, sender, unix_us()
