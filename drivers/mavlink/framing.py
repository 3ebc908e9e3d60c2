"""Bytes to sound MAVLink frames, without looking into their payloads.

The live link decodes few of the messages that it hears; of the others only the
checksum is looked at. Layouts: https://mavlink.io/en/guide/serialization.html.
"""

import re
from typing import NamedTuple

from fastcrc import crc16

from drivers.mavlink.dialect import mavlink

MAGIC_V1, MAGIC_V2 = 0xFE, 0xFD
HEADER_V1, HEADER_V2 = 6, 10  # bytes, the marker included
CHECKSUM_SIZE, SIGNATURE_SIZE = 2, 13
SIGNED_FLAG = 0x01  # the only incompatibility flag there is; frames with others are not for us
_MAGIC = re.compile(rb"[\xfd\xfe]")
_MAGICS = (MAGIC_V1, MAGIC_V2)


class Frame(NamedTuple):
    """One whole frame with a sound checksum, or of a message nobody here knows."""

    message_id: int
    system_id: int
    component_id: int
    data: bytes
    payload_at: int
    payload_end: int
    is_signed: bool


class FrameReader:
    """Bytes of one stream in, frames of MAVLink 1 and 2 out.

    An unreadable frame costs itself alone: what follows its first byte is read
    again. At most one frame's bytes (280) are kept from call to call. A frame of an
    unknown message has no checksum that can be judged: it counts if another frame
    or nothing follows it.
    """

    def __init__(self) -> None:
        kinds = mavlink().mavlink_map
        self._crc_extra = {number: bytes((kind.crc_extra,)) for number, kind in kinds.items()}
        self._rest = b""
        self._in_bad_stretch = False
        self._malformed = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Every frame completed by ``data``, in order."""
        if self._rest:
            data = self._rest + data
        frames: list[Frame] = []
        position, size = 0, len(data)
        while position < size:
            if data[position] not in _MAGICS:
                self._note_bad()
                magic = _MAGIC.search(data, position)
                if magic is None:
                    position = size
                    break
                position = magic.start()
            end = _frame_end(data, position)
            if end == 0 or end > size:
                following = self._sound_from(data, position + 1) if self._in_bad_stretch else None
                if following is None:
                    break  # the rest is still to come
                position = following
                continue
            frame = self._frame(data, position, end) if end > 0 else None
            if frame is None:
                self._note_bad()
                position += 1
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

    def _frame(self, data: bytes, start: int, end: int) -> Frame | None:
        """The frame from ``start`` to ``end``, or None if its checksum is wrong."""
        if data[start] == MAGIC_V2:
            is_signed = bool(data[start + 2] & SIGNED_FLAG)
            message_id = data[start + 7] | data[start + 8] << 8 | data[start + 9] << 16
            crc_at = end - CHECKSUM_SIZE - (SIGNATURE_SIZE if is_signed else 0)
            header, sender = HEADER_V2, start + 5
        else:
            is_signed, message_id = False, data[start + 5]
            crc_at, header, sender = end - CHECKSUM_SIZE, HEADER_V1, start + 3
        extra = self._crc_extra.get(message_id)
        if extra is None:
            if end < len(data) and data[end] not in _MAGICS:
                return None
        elif crc16.mcrf4xx(data[start + 1 : crc_at] + extra) != data[crc_at] | (
            data[crc_at + 1] << 8
        ):
            return None
        whole = data if end - start == len(data) else data[start:end]
        # made of a tuple: a third of the time of a call with the fields
        return Frame._make(
            (message_id, data[sender], data[sender + 1], whole, header, crc_at - start, is_signed)
        )

    def _sound_from(self, data: bytes, position: int) -> int | None:
        """Where the next whole frame with a sound checksum begins, if there is one.

        What seems to begin behind damage, and to go on beyond the data, may be damage itself.
        """
        for magic in _MAGIC.finditer(data, position):
            start = magic.start()
            end = _frame_end(data, start)
            if 0 < end <= len(data):
                frame = self._frame(data, start, end)
                if frame is not None and frame.message_id in self._crc_extra:
                    return start
        return None

    def _note_bad(self) -> None:
        if not self._in_bad_stretch:
            self._in_bad_stretch = True
            self._malformed += 1


def _frame_end(data: bytes, start: int) -> int:
    """Where the frame at ``start`` should end; 0 if that is not known yet, -1 if it is none."""
    if start + 3 > len(data):
        return 0
    length = data[start + 1]
    if data[start] == MAGIC_V1:
        return start + length + HEADER_V1 + CHECKSUM_SIZE
    flags = data[start + 2]
    if flags & ~SIGNED_FLAG:
        return -1
    signature = SIGNATURE_SIZE if flags else 0
    return start + length + HEADER_V2 + CHECKSUM_SIZE + signature
