"""The frames of many datagrams that hold nothing else, found by compiled code.

:class:`~drivers.mavlink.framing.FrameReader` reads any bytes. Nearly all datagrams are whole frames
of one sender and of known messages, with sound checksums: what it makes of those is found here,
all at one go. Any other datagram is left to it.
"""

from functools import cache
from typing import Any, NamedTuple

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
from drivers.mavlink.transports.datagrams import Datagrams
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import direct, types_of

Array = Any  # numba ships no types
LEFT = -1  # a datagram of which nothing is found here
SHORTEST = HEADER_V1 + CHECKSUM_SIZE
# Columns of a frame's row: of the payload PAYLOAD and END are where it begins and ends.
MESSAGE, SYSTEM, COMPONENT, BEGIN, STOP = 0, 1, 2, 3, 4
PAYLOAD, END, IS_SIGNED = 5, 6, 7
COLUMNS = 8
UNKNOWN = -1

_new_tuple = tuple.__new__


@compiled
def scan_frames(
    data: Array,
    begins: Array,
    ends: Array,
    extras: Array,
    wanted: Array,
    counts: Array,
    firsts: Array,
    senders: Array,
    rows: Array,
) -> int:
    """Find the frames of datagrams, the k-th of which is ``data[begins[k]:ends[k]]``.

    ``extras`` has each message's CRC_EXTRA, or :data:`UNKNOWN`. Of the ``wanted`` ones a row is
    written for each frame; ``counts`` tells how many rows a datagram has, or :data:`LEFT`,
    ``firsts`` which is its first, and ``senders`` of whom they are, as ``system << 8 | component``,
    or 0. Returns the number of rows.
    """
    written = 0
    for k in range(len(ends)):
        at, end, first, frames, sender = begins[k], ends[k], written, 0, -1
        firsts[k] = first
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
                row[MESSAGE], row[SYSTEM] = message, byte(data, sender_at)
                row[COMPONENT], row[IS_SIGNED] = byte(data, sender_at + 1), is_signed
                row[BEGIN], row[STOP], row[PAYLOAD], row[END] = at, stop, payload_at, crc_at
                written += 1
            at = stop
        if at == end and frames > 0:
            counts[k], senders[k] = written - first, sender
        else:
            counts[k], senders[k], written = LEFT, 0, first
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


class Scanned(NamedTuple):
    """Datagrams, and the frames found in them."""

    datagrams: Datagrams
    counts: Array  # of rows, by datagram; :data:`LEFT` where nothing was found
    firsts: Array  # rows, by datagram
    senders: Array  # by datagram: system << 8 | component, or 0
    rows: Array

    def rows_of(self, datagram: int) -> range:
        """Where a datagram's rows are."""
        first = int(self.firsts[datagram])
        return range(first, first + max(0, int(self.counts[datagram])))

    def frames(self, datagram: int) -> list[Frame]:
        """A datagram's frames."""
        return [self.frame(row) for row in self.rows_of(datagram)]

    def frame(self, row: int) -> Frame:
        """The frame of a row."""
        message, system, component, begin, stop, payload, end, is_signed = self.rows[row].tolist()
        at, data = (payload - begin, end - begin), self.datagrams.data[begin:stop].tobytes()
        return _new_tuple(Frame, (message, system, component, data, *at, is_signed == 1))


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

    def scan(self, datagrams: Datagrams) -> Scanned:
        """The frames of these datagrams."""
        data, begins, ends = datagrams[:3]
        found = counts, firsts, senders, rows = _found(len(ends), len(data))
        written = self._scan(data, begins, ends, self._extras, self._wanted, *found)
        return Scanned(datagrams, counts, firsts, senders, rows[:written])


def _found(datagrams: int, size: int) -> tuple[Array, Array, Array, Array]:
    counts, firsts, senders = np.empty((3, datagrams), np.int64)
    return counts, firsts, senders, np.empty((size // SHORTEST + 1, COLUMNS), np.int64)


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`scan_frames` is called with."""
    none = Datagrams.of([], 0)
    messages = (np.zeros(0, np.int64), np.zeros(0, np.bool_))
    return types_of(*none[:3], *messages, *_found(0, 0))
