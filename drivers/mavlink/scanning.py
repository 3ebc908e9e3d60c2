"""The frames of many datagrams that hold nothing else, found by compiled code.

:class:`~drivers.mavlink.framing.FrameReader` reads any bytes. Nearly all datagrams are whole frames
of one sender and of known messages, with sound checksums: what it makes of those is found here,
all at one go. Any other datagram is left to it.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numba
import numpy as np

from drivers.mavlink.dialect import mavlink
from drivers.mavlink.framing import (
    CHECKSUM_SIZE,
    HEADER_V1,
    HEADER_V2,
    MAGIC_V1,
    MAGIC_V2,
    SIGNATURE_SIZE,
    SIGNED_FLAG,
    Frame,
)
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import direct

Array = Any  # numba ships no types
LEFT = -1  # a datagram of which nothing is found here
SHORTEST = HEADER_V1 + CHECKSUM_SIZE
COLUMNS = 7  # message, sender's system and component, begin, end, payload's begin, is it signed
UNKNOWN = -1

_typeof: Any = numba.typeof
_new_tuple = tuple.__new__


@compiled
def scan_frames(
    data: Array, ends: Array, extras: Array, wanted: Array, counts: Array, rows: Array
) -> int:
    """Find the frames of datagrams, the k-th of which is ``data[ends[k]:ends[k + 1]]``.

    ``extras`` has each message's CRC_EXTRA, or :data:`UNKNOWN`. Of the ``wanted`` ones a row is
    written for each frame, counted from the datagram's begin; ``counts`` tells how many rows a
    datagram has, or :data:`LEFT`. Returns the number of rows.
    """
    written = 0
    for k in range(len(ends) - 1):
        at, end, first, frames, sender = ends[k], ends[k + 1], written, 0, -1
        while at < end:
            stop, message, sender_at, payload_at = header(data, at, end, len(extras))
            if stop < 0 or extras[message] == UNKNOWN:
                break
            crc_at = stop - CHECKSUM_SIZE
            is_signed = byte(data, at) == MAGIC_V2 and byte(data, at + 2) == SIGNED_FLAG
            if is_signed:
                crc_at -= SIGNATURE_SIZE
            if checksum(data, at + 1, crc_at, extras[message]) != stored(data, crc_at):
                break
            address = byte(data, sender_at) << 8 | byte(data, sender_at + 1)
            if sender not in (-1, address):
                break
            sender, frames = address, frames + 1
            if wanted[message]:
                row = rows[written]
                row[0], row[1], row[2] = message, byte(data, sender_at), byte(data, sender_at + 1)
                row[3], row[4], row[5] = at - ends[k], stop - ends[k], payload_at - at
                row[6] = is_signed
                written += 1
            at = stop
        if at == end and frames > 0:
            counts[k] = written - first
        else:
            counts[k], written = LEFT, first
    return written


@inlined
def header(data: Array, at: int, end: int, messages: int) -> tuple[int, int, int, int]:
    """A whole frame's end, message, sender's place and payload's begin; -1 if there is none."""
    if end - at < SHORTEST:
        return -1, 0, 0, 0
    size = byte(data, at + 1)
    if byte(data, at) == MAGIC_V1:
        stop, message = at + size + HEADER_V1 + CHECKSUM_SIZE, byte(data, at + 5)
        sender_at, payload_at = at + 3, at + HEADER_V1
    elif byte(data, at) == MAGIC_V2 and end - at >= HEADER_V2 and byte(data, at + 2) <= SIGNED_FLAG:
        stop = at + size + HEADER_V2 + CHECKSUM_SIZE + SIGNATURE_SIZE * byte(data, at + 2)
        message = byte(data, at + 7) | byte(data, at + 8) << 8 | byte(data, at + 9) << 16
        sender_at, payload_at = at + 5, at + HEADER_V2
    else:
        return -1, 0, 0, 0
    return (stop if stop <= end and message < messages else -1), message, sender_at, payload_at


@inlined
def checksum(data: Array, begin: int, end: int, extra: int) -> int:
    """CRC-16/MCRF4XX: https://mavlink.io/en/guide/serialization.html#checksum."""
    crc = 0xFFFF
    for i in range(begin, end):
        crc = with_byte(crc, byte(data, i))
    return with_byte(crc, extra)


@inlined
def with_byte(crc: int, byte: int) -> int:
    """A checksum with one more byte."""
    low = (byte ^ crc) & 0xFF
    low ^= low << 4 & 0xFF
    return crc >> 8 ^ low << 8 ^ low << 3 ^ low >> 4


@inlined
def stored(data: Array, at: int) -> int:
    """The checksum that a frame brings."""
    return byte(data, at) | byte(data, at + 1) << 8


@inlined
def byte(data: Array, at: int) -> int:
    """A byte as a whole number like all others here."""
    return np.int64(data[at])  # type: ignore[return-value]


class Scanner:
    """Finds the frames of the ``wanted`` messages."""

    def __init__(self, wanted: frozenset[int]) -> None:
        kinds = mavlink().mavlink_map
        self._extras = np.full(max(kinds) + 1, UNKNOWN, np.int64)
        self._wanted = np.zeros(len(self._extras), np.bool_)
        for number, kind in kinds.items():
            self._extras[number] = kind.crc_extra
            self._wanted[number] = number in wanted
        self._scan = direct(scan_frames, argument_types())

    def scan(self, datagrams: Sequence[bytes]) -> list[list[list[int]] | None]:
        """The rows of each datagram, see the kernel; None for one that is left."""
        data, ends, counts, rows = _arrays(datagrams)
        written = self._scan(data, ends, self._extras, self._wanted, counts, rows)
        all_rows, at = rows[:written].tolist(), 0
        found: list[list[list[int]] | None] = []
        for count in counts.tolist():
            found.append(None if count == LEFT else all_rows[at : at + count])
            at += max(count, 0)
        return found


def frame_of(data: bytes, row: list[int]) -> Frame:
    """The frame of a row."""
    message, system, component, begin, end, payload_at, is_signed = row
    payload_end = end - begin - CHECKSUM_SIZE - (SIGNATURE_SIZE if is_signed else 0)
    values = (message, system, component, data[begin:end], payload_at, payload_end, is_signed == 1)
    return _new_tuple(Frame, values)


def _arrays(datagrams: Sequence[bytes]) -> tuple[Array, Array, Array, Array]:
    n = len(datagrams)
    data = np.frombuffer(b"".join(datagrams), np.uint8)
    ends = np.zeros(n + 1, np.int64)
    np.cumsum(np.fromiter(map(len, datagrams), np.int64, n), out=ends[1:])
    rows = np.empty((len(data) // SHORTEST + 1, COLUMNS), np.int64)
    return data, ends, np.empty(n, np.int64), rows


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`scan_frames` is called with."""
    data, ends, counts, rows = _arrays([])
    messages = (np.zeros(0, np.int64), np.zeros(0, np.bool_))
    return tuple(map(_typeof, (data, ends, *messages, counts, rows)))
