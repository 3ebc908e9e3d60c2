"""ArduPilot's DataFlash format: messages that describe themselves.

A message is A3 95, its type, and a body. Those of type 0x80 (FMT) give a type its length, its
name, a character for each field, and the fields' names; ArduPilot writes them before the first
message of the type (libraries/AP_Logger/LogStructure.h).

The reading goes forwards only and keeps nothing but the formats, so that no damage can make it
hang or grow. What is not followed by another message, or by the end, is passed over.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from struct import Struct
from typing import Any, NamedTuple

from drivers.logs.log_file import Window

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

    def read(position: int) -> tuple[int, Sequence[tuple[str, Row] | None]]:
        data = window.data
        if (form := _sound(data, position, formats)) is None:
            return position, ()
        end = position + form.length
        if form is FMT:
            return end, () if _learn(formats, form.row(data, position)) else (None,)
        return end, ((form.name, form.row(data, position)),) if form.name in wanted else ()

    def search(position: int) -> int | None:
        while (position := window.data.find(HEAD, position)) >= 0:
            if _sound(window.data, position, formats) is not None:
                return position
            position += 1
        return None

    return window.records(0, read, search)


def _sound(data: bytes, position: int, formats: dict[int, Format]) -> Format | None:
    """The format of a message that is all there, with another one or the end behind it."""
    if position + HEAD_SIZE > len(data) or data[position : position + 2] != HEAD:
        return None
    form = formats.get(data[position + 2])
    end = 0 if form is None else position + form.length
    return form if end == len(data) or data[end : end + 2] == HEAD else None


def _learn(formats: dict[int, Format], row: Row) -> bool:
    """Take in what an FMT message describes; False if its codes do not fill its length."""
    if row["Type"] == FMT_TYPE:
        return True  # the description of FMT itself, which is always the same
    if not all(code in FIELDS for code in row["Format"]):
        return False
    fields = [FIELDS[code] for code in row["Format"]]
    layout = Struct("<" + "".join(stored for stored, _ in fields))
    if HEAD_SIZE + layout.size != row["Length"]:
        return False
    names = tuple(row["Columns"].split(","))[: len(fields)]  # or fewer: a long list is cut off
    values = tuple((i, value) for i, (_, value) in enumerate(fields[: len(names)]) if value)
    formats[row["Type"]] = Format(row["Name"], row["Length"], layout, names, values)
    return True


def _text(stored: bytes) -> str:
    return stored.partition(b"\0")[0].decode("utf-8", "replace")


# For each character of a format: how struct reads the field, and the function that converts it
FIELDS: dict[str, tuple[str, Callable[[Any], Any] | None]] = {
    **{code: (code, None) for code in "bBhHiIfdqQ"},
    **{code: (stored, None) for code, stored in (("g", "e"), ("M", "b"))},
    "a": ("64s", None),  # 32 numbers, in no message that is read here
    **{code: (stored, _text) for code, stored in (("n", "4s"), ("N", "16s"), ("Z", "64s"))},
    **{code: (stored, lambda n: n / 100) for code, stored in zip("cCeE", "hHiI", strict=True)},
    "L": ("i", lambda n: n / 1e7),
}

FMT = Format(
    "FMT",
    89,
    Struct("<BB4s16s64s"),
    ("Type", "Length", "Name", "Format", "Columns"),
    ((2, _text), (3, _text), (4, _text)),
)
