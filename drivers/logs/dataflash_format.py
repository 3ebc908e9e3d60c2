"""ArduPilot's DataFlash format: messages that say what they hold.

A message is A3 95, its type, and a body. Those of type 0x80 (FMT) give a type its length, its
name, a character for each field, and the fields' names; ArduPilot writes them before the first
message of the type (libraries/AP_Logger/LogStructure.h).

The reading goes forwards only and keeps nothing but the formats, so that no damage can make it
hang or grow. What is not followed by another message, or by the end, is passed over.
"""

from collections.abc import Callable, Collection, Iterator
from struct import Struct
from typing import Any, NamedTuple

from drivers.logs.log_file import MARGIN, Window

HEAD = b"\xa3\x95"
HEAD_SIZE = 3
FMT_TYPE = 0x80

Row = dict[str, Any]  # numbers and texts by the names of their fields


class Format(NamedTuple):
    """One type of message."""

    name: str
    length: int  # with the head
    layout: Struct
    columns: tuple[str, ...]
    values: tuple[tuple[int, Callable[[Any], Any]], ...]  # of the fields not stored as they are

    def row(self, data: bytes, position: int) -> Row:
        """The fields of the message at ``position``."""
        stored = self.layout.unpack_from(data, position + HEAD_SIZE)
        row = dict(zip(self.columns, stored, strict=False))
        for index, value in self.values:
            row[self.columns[index]] = value(stored[index])
        return row


def messages(window: Window, wanted: Collection[str]) -> Iterator[tuple[str, Row] | None]:
    """(name, fields) of the messages of those names; None for each unreadable stretch."""
    formats = {FMT_TYPE: FMT}
    unwanted: dict[int, int] = {}  # the lengths of those
    position = 0
    while True:
        position = _skip(window.data, position, unwanted)
        if window.is_near_end(position):
            position = window.move(position)
            continue
        data = window.data
        if position >= len(data):
            return
        form = _sound(data, position, formats) if data[position : position + 2] == HEAD else None
        if form is None:
            yield None
            position = window.find(position + 1, lambda at: _next_sound(window.data, at, formats))
            continue
        if form is FMT:
            if not _learn(formats, form.row(data, position)):
                yield None
            known = (*wanted, FMT.name)
            unwanted = {k: f.length for k, f in formats.items() if f.name not in known}
        elif form.name in wanted:
            yield form.name, form.row(data, position)
        position += form.length


def _skip(data: bytes, position: int, lengths: dict[int, int]) -> int:
    """The first place from ``position`` on that is no sound message of one of these lengths.

    A log may hold millions of them, three bytes long each: little is done for one.
    """
    last = len(data) - MARGIN
    while position < last and data[position] == HEAD[0] and data[position + 1] == HEAD[1]:
        length = lengths.get(data[position + 2])
        if length is None:
            break
        end = position + length
        if data[end] != HEAD[0] or data[end + 1] != HEAD[1]:
            break
        position = end
    return position


def _sound(data: bytes, position: int, formats: dict[int, Format]) -> Format | None:
    """The format of the message whose head is at ``position``, if all of it is there.

    None also if neither another message nor the end follows it.
    """
    size = len(data)
    form = formats.get(data[position + 2]) if position + HEAD_SIZE <= size else None
    if form is None:
        return None
    end = position + form.length
    return form if end == size or data[end : end + 2] == HEAD else None


def _next_sound(data: bytes, position: int, formats: dict[int, Format]) -> int | None:
    """Where the next sound message is."""
    while (position := data.find(HEAD, position)) >= 0:
        if _sound(data, position, formats) is not None:
            return position
        position += 1
    return None


def _learn(formats: dict[int, Format], row: Row) -> bool:
    """Take in what an FMT message describes; False if that cannot be."""
    if row["Type"] == FMT_TYPE:
        return True  # the description of FMT itself, which is always the same
    form = _format(row["Name"], row["Length"], row["Format"], row["Columns"])
    if form is not None:
        formats[row["Type"]] = form
    return form is not None


def _format(name: str, length: int, codes: str, columns: str) -> Format | None:
    """None if a code is unknown, or the codes do not fill the length."""
    if not all(code in FIELDS for code in codes):
        return None
    fields = [FIELDS[code] for code in codes]
    layout = Struct("<" + "".join(stored for stored, _ in fields))
    if HEAD_SIZE + layout.size != length:
        return None
    names = tuple(columns.split(","))[: len(fields)]  # or fewer: a long list is cut off
    values = ((index, value) for index, (_, value) in enumerate(fields[: len(names)]))
    return Format(name, length, layout, names, tuple((i, v) for i, v in values if v is not None))


def _text(stored: bytes) -> str:
    return stored.partition(b"\0")[0].decode("utf-8", "replace")


def _hundredths(stored: int) -> float:
    return stored / 100


def _degrees(stored: int) -> float:
    return stored / 1e7


# For each character of a format: how struct reads the field, and the function that converts it
FIELDS: dict[str, tuple[str, Callable[[Any], Any] | None]] = {
    **{code: (code, None) for code in "bBhHiIfdqQ"},
    **{code: (stored, None) for code, stored in (("g", "e"), ("M", "b"))},
    "a": ("64s", None),  # 32 numbers, in no message that is read here
    **{code: (stored, _text) for code, stored in (("n", "4s"), ("N", "16s"), ("Z", "64s"))},
    **{code: (stored, _hundredths) for code, stored in zip("cCeE", "hHiI", strict=True)},
    "L": ("i", _degrees),
}

FMT = Format(
    "FMT",
    89,
    Struct("<BB4s16s64s"),
    ("Type", "Length", "Name", "Format", "Columns"),
    ((2, _text), (3, _text), (4, _text)),
)
