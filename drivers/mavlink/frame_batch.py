"""Frames that have been judged, as bytes for another process of ours: nothing is judged twice."""

import msgspec

from drivers.mavlink.backlog import Arrived

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(list[Arrived])


def pack_frames(arrived: list[Arrived]) -> bytes:
    """The batch of these frames."""
    return _encoder.encode(arrived)


def unpack_frames(batch: bytes) -> list[Arrived]:
    """The frames of a batch, in order."""
    return _decoder.decode(batch)


def frame_count(batch: bytes) -> int:
    """How many frames there are in a batch."""
    return len(_decoder.decode(batch))
