"""MAVLink frames: where they begin and end, whether their checksums fit, and their fields.

Links and telemetry logs read their frames here. Fields are unpacked only if somebody wants them.
Layouts: https://mavlink.io/en/guide/serialization.html.
"""

import re
from collections import namedtuple
from collections.abc import Callable, Iterator
from functools import cache, partial
from struct import Struct
from typing import Any, NamedTuple

from fastcrc import crc16

from drivers.mavlink.constants import ATTITUDE_QUATERNION_ID, mavlink

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
HEADER_V1, HEADER_V2 = 6, 10  # bytes, the marker included
CHECKSUM_SIZE, SIGNATURE_SIZE = 2, 13
UNSIGNED_V2 = HEADER_V2 + CHECKSUM_SIZE
# Frames that are none are looked for so often in bytes that come together, and once more for so
# many of them: beyond that somebody wants it to take long.
MOST_TRIED, BYTES_A_TRY = 100, 64
SIGNED_FLAG = 0x01  # the only incompatibility flag there is; frames with others are not for us
_MAGIC = re.compile(rb"[\xfd\xfe]")
_MARKS = (b"\xfd", b"\xfe", b"")  # the first byte of a frame, or the data's end
# flags, the sequence number, system, component, and the message's number, whose upper byte is apart
_OF_V2, _OF_V1 = Struct("<xxBxBBBHB").unpack_from, Struct("<xxBBBB").unpack_from
_STRETCH = 1 << 12  # bytes; one without a marker is passed over some fifty times as fast

_new_tuple = tuple.__new__


class Frame(NamedTuple):
    """One whole frame with a sound checksum, or of a message nobody here knows."""

    message_id: int
    system_id: int
    component_id: int
    data: bytes
    payload_at: int
    payload_end: int
    is_signed: bool
    sequence: int = 0  # the number that its sender gave it, 0 to 255 and again


class FrameFormat:
    """Cuts frames out of bytes and judges their checksums.

    ``gap`` is how many bytes lie between one frame and the next: none on a link, a time
    stamp in a log. A frame of an unknown message has no checksum that can be judged: it
    counts if another frame or nothing follows it.
    """

    def __init__(self, gap: int = 0) -> None:
        kinds = mavlink().mavlink_map
        self._crc_extra = {number: bytes((kind.crc_extra,)) for number, kind in kinds.items()}
        self._gap = gap

    def frame(self, data: bytes, start: int, end: int) -> Frame | None:
        """The frame from ``start`` to ``end``, as :func:`frame_end` gave it; None if unsound."""
        crc_at, header, flags = end - CHECKSUM_SIZE, HEADER_V2, 0
        if data[start] == MAGIC_V2:
            flags, sequence, system, component, message_id, upper = _OF_V2(data, start)
            message_id |= upper << 16
            crc_at -= SIGNATURE_SIZE if flags else 0
        else:
            header = HEADER_V1
            sequence, system, component, message_id = _OF_V1(data, start)
        extra = self._crc_extra.get(message_id)
        if extra is None:
            if not self.is_followed(data, end):
                return None
        elif crc16.mcrf4xx(data[start + 1 : crc_at] + extra) != data[crc_at] | (
            data[crc_at + 1] << 8
        ):
            return None
        # made of a tuple, without its class's own Python code: a quarter of the time
        frame, payload_end = data[start:end], crc_at - start
        is_signed = bool(flags)
        parts = message_id, system, component, frame, header, payload_end, is_signed, sequence
        return _new_tuple(Frame, parts)

    def is_followed(self, data: bytes, end: int) -> bool:
        """Whether behind a frame's end another one begins, or the data end."""
        following = end + self._gap
        return data[following : following + 1] in _MARKS

    def next_start(self, data: bytes, position: int) -> int | None:
        """Where the next whole frame of a known message with a sound checksum begins, if any.

        What seems to begin behind damage, and to go on beyond the data, may be damage itself.
        """
        for start in _markers(data, position):
            end = frame_end(data, start)
            if end is not None and end <= len(data):
                frame = self.frame(data, start, end)
                if frame is not None and frame.message_id in self._crc_extra:
                    return start
        return None


class FrameReader:
    """Bytes of one stream in, frames of MAVLink 1 and 2 out.

    An unreadable frame costs itself alone: what follows its first byte is read
    again, unless nearly every byte seems to begin one. At most one frame's bytes are kept
    from call to call.
    """

    def __init__(self) -> None:
        self._format = FrameFormat()
        self._rest = b""
        self._in_bad_stretch = False
        self._malformed = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Every frame completed by ``data``, in order."""
        if self._rest:
            data = self._rest + data
        frames: list[Frame] = []
        position, size = 0, len(data)
        left = MOST_TRIED + size // BYTES_A_TRY
        while position < size:
            end = frame_end(data, position)
            if end is not None and end > size:
                following = None
                if self._in_bad_stretch:
                    following = self._format.next_start(data, position + 1)
                if following is None:
                    break  # the rest is still to come
                position = following
                continue
            frame = None if end is None else self._format.frame(data, position, end)
            if frame is None or end is None:
                self._malformed += not self._in_bad_stretch
                self._in_bad_stretch = True
                left -= 1
                position = next(_markers(data, position + 1), size) if left else size
                continue
            self._in_bad_stretch = False
            frames.append(frame)
            position = end
        self._rest = data[position:]
        return frames

    def take_malformed(self) -> int:
        """How many unreadable stretches there were since the last call."""
        count, self._malformed = self._malformed, 0
        return count


def frame_end(data: bytes, start: int) -> int | None:
    """Where the frame at ``start`` ends by its own header; None if none begins there.

    If the data end within the header, the shortest frame that it may be the beginning of is
    assumed; its end is beyond the data.
    """
    head = data[start : start + 3]
    if len(head) < 3:
        return start + HEADER_V1 + CHECKSUM_SIZE if head[:1] in _MARKS else None
    magic, length, flags = head
    if magic == MAGIC_V2:
        if not flags:
            return start + length + UNSIGNED_V2  # nearly always
        return start + length + UNSIGNED_V2 + SIGNATURE_SIZE if flags == SIGNED_FLAG else None
    return start + length + HEADER_V1 + CHECKSUM_SIZE if magic == MAGIC_V1 else None


def _markers(data: bytes, position: int) -> Iterator[int]:
    """Where the bytes are that may begin a frame; a hole of gigabytes in a file has none."""
    for begin in range(position, len(data), _STRETCH):
        end = begin + _STRETCH
        if data.find(b"\xfd", begin, end) >= 0 or data.find(b"\xfe", begin, end) >= 0:
            for magic in _MAGIC.finditer(data, begin, end):
                yield magic.start()


_ARRAY_AT_END = frozenset({ATTITUDE_QUATERNION_ID})


class Layout(NamedTuple):
    """A message's fields in the order of the wire, and what makes a named tuple of them."""

    names: tuple[str, ...]
    struct: Struct
    make: Callable[[tuple[Any, ...]], Any]


@cache
def layout(message_id: int) -> Layout | None:
    """The layout of a message of the dialect; None if arrays matter in it.

    Extensions stand at the end; an array among them is left out.
    """
    kind = mavlink().mavlink_map[message_id]
    names, struct = tuple(kind.ordered_fieldnames), kind.unpacker
    arrays = [k for k, length in enumerate(kind.array_lengths) if length]
    if arrays:
        if message_id not in _ARRAY_AT_END:
            return None
        names = names[: arrays[0]]
        struct = Struct("<" + kind.unpacker.format.lstrip("<")[: arrays[0]])
    new: Any = namedtuple  # noqa: PYI024 - of names that are the dialect's
    return Layout(names, struct, partial(_new_tuple, new(kind.msgname, names)))


def fields(frame: Frame) -> Any:
    """What has the fields as attributes of a sound frame of a message of the dialect.

    pymavlink builds a large object of every message. Fields before the first array, which are all
    that matter of nearly all messages that come often, are unpacked straight from the frame.
    Zeros at a payload's end are not sent, nor fields that the sender does not know; what is
    longer than the definition comes from a newer one.
    """
    known = layout(frame.message_id)
    if known is None:
        return parsed(frame.data)
    _, struct, make = known
    payload = frame.data[frame.payload_at : frame.payload_end]
    missing = struct.size - len(payload)
    if missing > 0:
        payload += bytes(missing)
    return make(struct.unpack_from(payload))


def parsed(data: bytes) -> Any:
    """pymavlink's message of exactly one sound frame, or its stand-in for one it does not know."""
    return _parser().decode(bytearray(data))


@cache
def _parser() -> Any:
    return mavlink().MAVLink(None)
