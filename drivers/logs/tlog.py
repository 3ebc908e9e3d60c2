"""Telemetry logs (.tlog, and MAVProxy's .log): frames with the times they arrived.

Each record is a big-endian 64-bit Unix time in microseconds and one MAVLink
frame. Recorders put a link number into the two low bits, write garbage, and
sometimes a time from another age; none of that stops the reading.
"""

import mmap
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from fastcrc import crc16

from drivers.events import Event, Malformed
from drivers.logs.log_file import LogFile, mapped
from drivers.mavlink.decoder import FrameParser, MavlinkDecoder
from drivers.mavlink.dialect import mavlink
from estimator.errors import InputError

STAMP_SIZE = 8
MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
OVERHEAD_V1, OVERHEAD_V2, SIGNATURE_SIZE = 8, 12, 13
SIGNED_FLAG = 0x01
MAGIC = re.compile(rb"[\xfd\xfe]")

ORDINARY_STEP_US = 10 * 1_000_000  # a stamp further from the last one needs a witness
ORDINARY_BACK_US = 5 * 1_000_000
STAMP_STEP_US = 86_400 * 1_000_000  # the first two stamps are within a day
LATEST_STAMP_US = 1 << 62  # garbage beyond: differences must fit 64 bits
STAMP_BACK_US = 3600 * 1_000_000
SNIFF_SIZE = 1 << 20  # a log has a sound frame within its first MiB
FIRST_RECORDS = 100  # two stamps among these agree, or the first ones mean nothing
RAW_FRAMES = 3  # that many sound frames end to end are no accident


def believable(
    records: Iterable[tuple[int, Any | None]], last_us: int
) -> Iterator[tuple[int, Any | None]]:
    """The records with times to believe, from ``last_us`` on.

    A stamp away from the last one waits for the next record: if that is nearer to it than
    to the last, there was a pause, or a second session in the same file; if not, it was
    garbled, and the last good stamp stands in. An unreadable record's own stamp is as
    doubtful as its frame.
    """
    held: tuple[int, Any] | None = None
    for stamp_us, message in records:
        if message is None:
            yield last_us, None
            continue
        if held is not None:
            held_us, held_message = held
            held = None
            if abs(stamp_us - held_us) < abs(stamp_us - last_us):
                last_us = held_us
            yield last_us, held_message
        if -ORDINARY_BACK_US <= stamp_us - last_us <= ORDINARY_STEP_US:
            last_us = stamp_us
            yield last_us, message
        else:
            held = stamp_us, message
    if held is not None:
        yield last_us, held[1]


def _near(stamp_us: int, other_us: int) -> bool:
    return -STAMP_BACK_US <= stamp_us - other_us <= STAMP_STEP_US


class Tlog(LogFile):
    """A telemetry log as events; each iteration reads the file from its start.

    Raises:
        InputError: from the constructor, if the file holds no MAVLink frame
            with a time before it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with mapped(path) as data:
            if _is_raw_capture(data):
                raise InputError(
                    f"{path}: MAVLink without time stamps (a raw capture), use the .tlog beside it"
                )
            if next(TlogRecords(data[:SNIFF_SIZE], None).readable(), None) is None:
                raise InputError(f"{path}: no MAVLink frame in it, not a telemetry log")

    def __iter__(self) -> Iterator[Event]:
        decoder = MavlinkDecoder()
        with mapped(self.path) as data:
            records = TlogRecords(data, decoder.message_names)
            for arrival_us, message in believable(records, _first_stamp_us(data)):
                if message is None:
                    yield Malformed(arrival_us, 1)
                else:
                    yield from decoder.decode(message, arrival_us)


class TlogRecords:
    """The records of a telemetry log: (stamp in us, message, or None where it is unreadable).

    Only messages named in ``wanted`` (None: all) are decoded and given; of the
    others only the checksum is looked at, which makes most of the speed.
    """

    def __init__(self, data: mmap.mmap | bytes, wanted: frozenset[str] | None) -> None:
        self._data = data
        self._parser = FrameParser()
        dialect = mavlink()
        self._kinds = kinds = dialect.mavlink_map
        self._wanted_ids = frozenset(
            number for number, kind in kinds.items() if wanted is None or kind.msgname in wanted
        )

    def __iter__(self) -> Iterator[tuple[int, Any | None]]:
        size, position, stamp_us = len(self._data), 0, 0
        while position + STAMP_SIZE < size:
            end = self._record_end(position)
            in_chain = end is not None and self._begins_record(end)
            if end is not None and in_chain:
                stamp_us = self._stamp_us(position)
                if self._message_id(position) not in self._wanted_ids:
                    if not self._is_sound(position, end):
                        yield stamp_us, None
                    position = end
                    continue
            message = self._decode(position, end)
            if end is None or (message is None and not in_chain):
                yield stamp_us, None
                position = self._next_readable(position + 1)
                continue
            if message is None:
                yield stamp_us, None
            elif message.get_msgId() in self._wanted_ids:
                stamp_us = self._stamp_us(position)
                yield stamp_us, message
            position = end

    def readable(self) -> Iterator[tuple[int, Any]]:
        """The records without the unreadable ones."""
        return ((stamp_us, message) for stamp_us, message in self if message is not None)

    def _stamp_us(self, position: int) -> int:
        stamp_us = int.from_bytes(self._data[position : position + STAMP_SIZE], "big")
        return min(stamp_us, LATEST_STAMP_US)

    def _record_end(self, position: int) -> int | None:
        end = frame_end(self._data, position + STAMP_SIZE)
        return end if end is not None and end <= len(self._data) else None

    def _begins_record(self, position: int) -> bool:
        start = position + STAMP_SIZE
        if start >= len(self._data):
            return True  # nothing follows that could contradict
        return self._data[start] in (MAGIC_V1, MAGIC_V2)

    def _message_id(self, position: int) -> int:
        data, start = self._data, position + STAMP_SIZE
        if data[start] == MAGIC_V1:
            return data[start + 5]
        return int.from_bytes(data[start + 7 : start + 10], "little")

    def _is_sound(self, position: int, end: int) -> bool:
        """Whether the frame's checksum fits; one of an unknown message cannot be judged."""
        data, start = self._data, position + STAMP_SIZE
        kind = self._kinds.get(self._message_id(position))
        if kind is None:
            return True
        is_signed = data[start] == MAGIC_V2 and data[start + 2] & SIGNED_FLAG
        crc_at = end - (SIGNATURE_SIZE if is_signed else 0) - 2
        expected = crc16.mcrf4xx(data[start + 1 : crc_at] + bytes((kind.crc_extra,)))
        return expected == int.from_bytes(data[crc_at : crc_at + 2], "little")

    def _decode(self, position: int, end: int | None) -> Any | None:
        if end is None:
            return None
        return self._parser.frame(self._data[position + STAMP_SIZE : end])

    def _next_readable(self, position: int) -> int:
        """Where the next record with a frame of sound checksum begins, or the data's end."""
        for magic in MAGIC.finditer(self._data, position + STAMP_SIZE):
            start = magic.start() - STAMP_SIZE
            end = self._record_end(start)
            if end is None or self._message_id(start) not in self._kinds:
                continue
            if self._is_sound(start, end) and self._decode(start, end) is not None:
                return start
        return len(self._data)


def frame_end(data: mmap.mmap | bytes, start: int) -> int | None:
    """Where the frame that begins at ``start`` ends by its own header; None if none begins."""
    if start + OVERHEAD_V1 > len(data):
        return None
    magic, length = data[start], data[start + 1]
    if magic == MAGIC_V1:
        return start + length + OVERHEAD_V1
    if magic == MAGIC_V2:
        signature = SIGNATURE_SIZE if data[start + 2] & SIGNED_FLAG else 0
        return start + length + OVERHEAD_V2 + signature
    return None


def _first_stamp_us(data: mmap.mmap | bytes) -> int:
    """The first stamp that the next one agrees with: a file may begin in mid-record."""
    previous_us = 0
    for number, (stamp_us, _) in enumerate(TlogRecords(data, None).readable()):
        if number and _near(stamp_us, previous_us):
            return previous_us
        if number >= FIRST_RECORDS:
            break
        previous_us = stamp_us
    return previous_us


def _is_raw_capture(data: mmap.mmap | bytes) -> bool:
    """Whether the data begins with frames one behind the other, without times between."""
    parser, position = FrameParser(), 0
    for _ in range(RAW_FRAMES):
        end = frame_end(data, position)
        if end is None or end > len(data) or parser.frame(data[position:end]) is None:
            return False
        position = end
    return True
