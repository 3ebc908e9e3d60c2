"""Datagrams read many at a time, by one call of the system instead of one each: recvmmsg(2).

Python has no name for it. The memory that the system writes to is laid out as Linux on 64 bits
has it (``struct mmsghdr``, ``iovec``, ``sockaddr_in``, ``cmsghdr`` with a ``timespec``).
"""

import ctypes
import errno
import socket
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from drivers.mavlink.transports.datagrams import Array, Datagrams
from drivers.mavlink.transports.sockets import RECEIVE_BYTES
from estimator.compilation.compiled import compiled, inlined, is_compiled_code
from estimator.compilation.direct import direct, types_of

AT_ONCE = 64  # datagrams a call
# More than the largest datagram, and no multiple of a page, so that not all begin in one line of
# the processor's cache.
SLOT_BYTES = RECEIVE_BYTES + 64
ADDRESS_BYTES, CONTROL_BYTES = 16, 64
IS_IT = sys.platform == "linux" and sys.maxsize > 1 << 32

HEADER = np.dtype(
    {
        "names": ["name", "name_size", "parts", "part_count", "control", "control_size", "size"],
        "formats": [np.uint64, np.uint32, np.uint64, np.uint64, np.uint64, np.uint64, np.uint32],
        "offsets": [0, 8, 16, 24, 32, 40, 56],
        "itemsize": 64,
    }
)
PART = np.dtype([("begin", np.uint64), ("size", np.uint64)])
# Within a control message: its size, level and kind, and seconds and nanoseconds.
STAMP_BYTES = 32
SO_TIMESTAMPNS = 35
SOL_SOCKET_AND_STAMP = socket.SOL_SOCKET | SO_TIMESTAMPNS << 32
FIRST_BYTES = 1 << 16
PORT_BITS = 16


@compiled
def collect(
    slots: Array,
    addresses: Array,
    controls: Array,
    headers: tuple[Array, Array, Array],
    count: int,
    found: tuple[Array, Array, Array, Array],
    n: int,
) -> int:
    """Put the first ``count`` slots' datagrams behind the ``n`` that are there.

    ``headers`` are their sizes, and those of addresses and controls, which are made ready for the
    next call; ``found`` are the arrays of :class:`Datagrams`. A datagram without a time has 0, one
    without a byte says nothing, and is left out.
    Returns how many datagrams there are now; -1, and nothing done, if there is no room.
    """
    sizes, address_sizes, control_sizes = headers
    data, ends, peers, arrivals_us = found
    size = ends[n]
    for k in range(count):
        size += np.int64(sizes[k])
    if n + count >= len(ends) or size > len(data):
        return -1
    for k in range(count):
        begin, size = ends[n], np.int64(sizes[k])
        is_stamp = control_sizes[k] == STAMP_BYTES and controls[k, 1] == SOL_SOCKET_AND_STAMP
        address_sizes[k], control_sizes[k] = ADDRESS_BYTES, CONTROL_BYTES
        if size == 0:
            continue
        for i in range(size):
            data[begin + i] = slots[k, i]
        ends[n + 1] = begin + size
        peers[n] = ipv4_peer(addresses[k])
        stamp = controls[k]
        arrivals_us[n] = stamp[2] * 1_000_000 + stamp[3] // 1000 if is_stamp else 0
        n += 1
    return n


@inlined
def ipv4_peer(address: Array) -> int:
    """The number of a sender: its address and port, which are in the order of the network."""
    number: Any = np.int64(0)
    for i in range(4, 8):
        number = number << 8 | address[i]
    found: int = number << PORT_BITS | np.int64(address[2]) << 8 | np.int64(address[3])
    return found


def ipv4_number(host: str, port: int) -> int:
    """The number of a sender."""
    return int.from_bytes(socket.inet_aton(host), "big") << PORT_BITS | port


def ipv4_sender(number: int) -> tuple[str, int]:
    """Host and port of a sender, by its number."""
    host = socket.inet_ntoa((number >> PORT_BITS).to_bytes(4, "big"))
    return host, number & ((1 << PORT_BITS) - 1)


def ipv4_name(number: int) -> str:
    """The name of a sender."""
    host, port = ipv4_sender(number)
    return f"{host}:{port}"


class ManyReader:
    """Reads what an IPv4 socket has; made for one socket, used by one thread."""

    def __init__(self, own: socket.socket) -> None:
        self._own = own
        self._slots = np.empty((AT_ONCE, SLOT_BYTES), np.uint8)  # most of it is never touched
        self._addresses = np.zeros((AT_ONCE, ADDRESS_BYTES), np.uint8)
        self._controls = np.zeros((AT_ONCE, CONTROL_BYTES // 8), np.int64)
        self._parts = np.zeros(AT_ONCE, PART)
        self._headers = headers = np.zeros(AT_ONCE, HEADER)
        each = np.arange(AT_ONCE, dtype=np.uint64)
        self._parts["begin"] = _address(self._slots) + each * np.uint64(SLOT_BYTES)
        self._parts["size"] = RECEIVE_BYTES
        headers["name"] = _address(self._addresses) + each * np.uint64(ADDRESS_BYTES)
        headers["parts"] = _address(self._parts) + each * np.uint64(PART.itemsize)
        headers["part_count"] = 1
        headers["control"] = _address(self._controls) + each * np.uint64(CONTROL_BYTES)
        self._pointer = int(_address(headers))
        headers["name_size"], headers["control_size"] = ADDRESS_BYTES, CONTROL_BYTES
        self._sizes = tuple(headers[name] for name in ("size", "name_size", "control_size"))
        self._collect = direct(collect, argument_types())
        self._receive = _recvmmsg()
        self._found = _found(AT_ONCE, FIRST_BYTES)

    def read(self, most: int, now_us: Callable[[], int]) -> tuple[Datagrams, int]:
        """Datagrams that are there, at least up to ``most`` of them, and an error number or 0.

        ``now_us`` is when those have come of which the system does not say. What is returned is
        this reader's own memory until the next call.
        """
        n, taken, failure, file = 0, 0, 0, self._own.fileno()
        while taken < most:
            count = self._receive(file, self._pointer, AT_ONCE, socket.MSG_DONTWAIT, None)
            if count < 0:
                failure = ctypes.get_errno()
                break
            n, taken = self._collected(n, count), taken + count
            if count < AT_ONCE:
                break
        data, ends, peers, arrivals_us = self._found
        data = data[: ends[n]]
        data.flags.writeable = False
        if n and not arrivals_us[n - 1]:
            arrivals_us[:n][arrivals_us[:n] == 0] = now_us()
        bounds = (ends[:n], ends[1 : n + 1])
        found = Datagrams(data, *bounds, peers[:n], arrivals_us[:n], ipv4_name)
        return found, 0 if failure in (errno.EAGAIN, errno.EINTR) else failure

    def _collected(self, n: int, count: int) -> int:
        """The number of datagrams with those that have just been read."""
        memory = (self._slots, self._addresses, self._controls, self._sizes)
        while (there := self._collect(*memory, count, self._found, n)) < 0:
            before = self._found
            size = int(self._sizes[0][:count].sum())
            self._found = _found(2 * len(before[1]) + count, 2 * len(before[0]) + size)
            for old, new in zip(before, self._found, strict=True):
                new[: len(old)] = old
        return int(there)


def can_read_many(own: socket.socket) -> bool:
    """Whether a socket can be read by this."""
    return IS_IT and own.family == socket.AF_INET and is_compiled_code()


def _found(datagrams: int, size: int) -> tuple[Array, Array, Array, Array]:
    numbers = (np.zeros(datagrams + 1, np.int64) for _ in range(3))
    ends, peers, arrivals_us = numbers
    return np.empty(size, np.uint8), ends, peers, arrivals_us


def _address(array: Array) -> Any:
    return np.uint64(array.ctypes.data)


@cache
def _recvmmsg() -> Callable[..., int]:
    library = ctypes.CDLL(None, use_errno=True)
    call = library.recvmmsg
    call.argtypes = (
        *(ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p),
    )
    return call


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`collect` is called with."""
    bytes_, controls = np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.int64)
    headers = np.zeros(2, HEADER)  # of one, a field would pass for contiguous
    sizes = tuple(headers[name] for name in ("size", "name_size", "control_size"))
    return types_of(bytes_, bytes_, controls, sizes, 0, _found(0, 0), 0)
