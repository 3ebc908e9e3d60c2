# ruff: noqa: D102 - what each method does is written once, at Transport
"""UDP: listening on a port, or sending to an address first."""

import errno
import socket
from collections import OrderedDict
from struct import Struct
from typing import Any

from drivers.endpoint import Endpoint
from drivers.mavlink.transports import transport
from drivers.mavlink.transports.transport import SO_TIMESTAMPNS, Packet, Transport, unix_us

# Reads in one call before the owner gets them: a flood cannot keep it from anything else.
RECEIVE_READS = 2048
# Senders to answer on one UDP port; the one silent for longest is forgotten first
MOST_UDP_PEERS = 32
# A datagram that could not be delivered is like a lost one
LOST_DATAGRAM = (errno.ECONNREFUSED, errno.ENOBUFS, errno.EMSGSIZE, errno.ECONNRESET)

SO_MEMINFO = 55  # how many datagrams Linux has thrown away (linux/sock_diag.h)
TIMESPEC = Struct("@ll")  # s, ns
MEMINFO = Struct("@9I")
MEMINFO_DROPS = 8
ANCILLARY_BYTES = 64


class Udp(Transport):
    """Listens on a port and answers all who have sent something, or sends to one address first.

    Then only what that host sends back is taken.
    """

    _target: Any = None  # the one address

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._peers: OrderedDict[Any, str] = OrderedDict()  # names by address

    @property
    def lost(self) -> int:
        """Datagrams that the system has thrown away; to ask it takes as long as to read some."""
        if not transport.IS_LINUX or self._socket is None:
            return 0
        info = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMINFO.size)
        # old kernels show less
        return int(MEMINFO.unpack(info)[MEMINFO_DROPS]) if len(info) == MEMINFO.size else 0

    def open(self) -> None:
        self._peers.clear()
        if self._endpoint.kind == "udpin":
            self._socket = transport.listening_socket(self._endpoint, socket.SOCK_DGRAM)
            return
        family, self._target = transport.resolve(self._endpoint, socket.SOCK_DGRAM)
        self._socket = transport.new_socket(family, socket.SOCK_DGRAM)

    def receive(self, timeout_s: float) -> list[Packet]:
        assert self._socket is not None
        own, packets = self._socket, list[Packet]()
        own.settimeout(max(0.0, timeout_s))
        for _ in range(RECEIVE_READS):
            try:
                data, sender, arrival_us = _read(own)
            except (BlockingIOError, InterruptedError, TimeoutError):
                break
            except OSError as error:
                if error.errno not in LOST_DATAGRAM:
                    raise
            else:
                # one without a byte ends no connection as in a stream
                if data and (self._target is None or sender[0] == self._target[0]):
                    packets.append(Packet(self._peer(sender), data, arrival_us))
            if own.gettimeout():  # none but the first is waited for
                own.setblocking(False)
        own.setblocking(False)
        return packets

    def send(self, data: bytes) -> None:
        assert self._socket is not None
        for address in [*self._peers] if self._target is None else [self._target]:
            try:
                self._socket.sendto(data, address)
            except (BlockingIOError, InterruptedError):
                continue
            except OSError as error:
                if error.errno not in LOST_DATAGRAM:
                    raise

    def _peer(self, sender: Any) -> str:
        """The name of a sender, who is remembered."""
        name = self._peers.pop(sender, None) or f"{sender[0]}:{sender[1]}"
        self._peers[sender] = name  # behind all others
        if len(self._peers) > MOST_UDP_PEERS:
            self._peers.popitem(last=False)
        return name


def _read(own: socket.socket) -> tuple[bytes, Any, int]:
    if not transport.IS_LINUX:
        return (*own.recvfrom(transport.RECEIVE_BYTES), unix_us())
    data, ancillary, _flags, sender = own.recvmsg(transport.RECEIVE_BYTES, ANCILLARY_BYTES)
    if len(ancillary) == 1:
        ((level, kind, stamp),) = ancillary
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(stamp) == TIMESPEC.size:
            s, ns = TIMESPEC.unpack(stamp)
            return data, sender, s * 1_000_000 + ns // 1000
    return data, sender, unix_us()
