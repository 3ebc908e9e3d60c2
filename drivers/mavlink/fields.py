"""A frame's fields, by their names in the dialect.

pymavlink builds a large object of every message. Fields before the first array, which are all that
matter of nearly all messages that come often, are unpacked here straight from the frame, by
pymavlink's definitions.
"""

from collections import namedtuple
from collections.abc import Callable
from functools import cache
from struct import Struct
from typing import Any, NamedTuple

from drivers.mavlink.constants import ATTITUDE_QUATERNION_ID
from drivers.mavlink.dialect import Unpacker, mavlink
from drivers.mavlink.framing import Frame

_ARRAY_AT_END = frozenset({ATTITUDE_QUATERNION_ID})


class Layout(NamedTuple):
    """A message's fields in the order of the wire, and what makes a named tuple of them."""

    names: tuple[str, ...]
    struct: Struct
    make: Callable[[tuple[Any, ...]], Any]


@cache
def layout(message_id: int) -> Layout | None:
    """The layout of a message; None if the dialect does not know it, or arrays matter in it.

    Extensions stand at the end; an array among them is left out.
    """
    kind = mavlink().mavlink_map.get(message_id)
    if kind is None:
        return None
    names, struct = tuple(kind.ordered_fieldnames), kind.unpacker
    arrays = [k for k, length in enumerate(kind.array_lengths) if length]
    if arrays:
        if message_id not in _ARRAY_AT_END:
            return None
        names = names[: arrays[0]]
        struct = Struct("<" + kind.unpacker.format.lstrip("<")[: arrays[0]])
    new: Any = namedtuple  # noqa: PYI024 - of names that are the dialect's
    return Layout(names, struct, new(kind.msgname, names)._make)


class FieldReader:
    """Makes of a frame what has its fields as attributes."""

    def __init__(self) -> None:
        self._unpacker = Unpacker()

    def fields(self, frame: Frame) -> Any | None:
        """The fields of a frame with a sound checksum; None if it is no message of the dialect.

        Zeros at a payload's end are not sent, nor fields that the sender does not know; what is
        longer than the definition comes from a newer one.
        """
        known = layout(frame.message_id)
        if known is None:
            return self._unpacker.message(frame.data)
        _, struct, make = known
        payload = frame.data[frame.payload_at : frame.payload_end]
        missing = struct.size - len(payload)
        if missing > 0:
            payload += bytes(missing)
        return make(struct.unpack_from(payload))
