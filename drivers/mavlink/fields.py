"""A frame's fields, by their names in the dialect.

pymavlink builds a large object of every message. Of messages without arrays, which are nearly all
that come often, the fields are unpacked here straight from the frame, by pymavlink's definitions.
"""

from collections import namedtuple
from collections.abc import Callable
from functools import cache
from struct import Struct
from typing import Any, NamedTuple

from drivers.mavlink.dialect import Unpacker, mavlink
from drivers.mavlink.framing import Frame


class Layout(NamedTuple):
    """A message's fields in the order of the wire, and what makes a named tuple of them."""

    names: tuple[str, ...]
    struct: Struct
    make: Callable[[tuple[Any, ...]], Any]


@cache
def layout(message_id: int) -> Layout | None:
    """The layout of a message; None if it has arrays, or the dialect does not know it."""
    kind = mavlink().mavlink_map.get(message_id)
    if kind is None or any(kind.array_lengths):
        return None
    names = tuple(kind.ordered_fieldnames)
    new: Any = namedtuple  # noqa: PYI024 - of names that are the dialect's
    return Layout(names, kind.unpacker, new(kind.msgname, names)._make)


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
