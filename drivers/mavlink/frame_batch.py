"""Frames that have been judged, as bytes for another process of ours: nothing is judged twice.

A batch is the number of frames, a head of fixed size for each, and the frames' own bytes.
"""

from struct import Struct

from drivers.mavlink.backlog import Arrived
from drivers.mavlink.framing import Frame

_COUNT = Struct("<I")
# arrival (us), message, begin and end of the payload, size, system, component, signed
_HEAD = Struct("<QIHHHBBB")


def pack_frames(arrived: list[Arrived]) -> bytes:
    """The batch of these frames."""
    pack = _HEAD.pack
    heads = [_COUNT.pack(len(arrived))]
    frames = []
    for arrival_us, frame in arrived:
        message_id, system_id, component_id, data, begin, end, is_signed = frame
        heads.append(
            pack(arrival_us, message_id, begin, end, len(data), system_id, component_id, is_signed)
        )
        frames.append(data)
    return b"".join(heads + frames)


def unpack_frames(batch: bytes) -> list[Arrived]:
    """The frames of a batch, in order."""
    (count,) = _COUNT.unpack_from(batch)
    at = _COUNT.size + count * _HEAD.size
    arrived = []
    for head in _HEAD.iter_unpack(memoryview(batch)[_COUNT.size : at]):
        arrival_us, message_id, begin, end, size, system_id, component_id, is_signed = head
        data = batch[at : at + size]
        at += size
        fields = (message_id, system_id, component_id, data, begin, end, bool(is_signed))
        arrived.append(Arrived(arrival_us, Frame._make(fields)))
    return arrived


def frame_count(batch: bytes) -> int:
    """How many frames there are in a batch."""
    (count,) = _COUNT.unpack_from(batch)
    return int(count)
