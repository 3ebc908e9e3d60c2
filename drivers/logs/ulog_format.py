"""PX4's ULog format: messages, the topics they belong to, and where their rows are.

A message is its size (16 bits), its type (a letter) and a body. F gives a format its fields,
A gives a number to a topic, D is a row of the topic of that number, P a parameter
(https://docs.px4.io/main/en/dev_log/ulog_file_format.html).

What the file claims is never believed further than it reaches: no format is unrolled but for
the fields that are wanted, and the reading goes forwards only, in pieces, and keeps nothing but
definitions. After damage it goes on with the next message that cannot be an accident.
"""

import re
from collections.abc import Iterator, Mapping
from enum import IntEnum
from struct import Struct, error
from typing import Any, NamedTuple

from drivers.logs.log_file import LATEST_US, Window

MAGIC = b"ULog\x01\x12\x35"
FILE_HEAD_SIZE = 16
HEAD = Struct("<HB")
KNOWN_TYPES = frozenset(b"ABCDFILMOPQRS")
TELLING_TYPES = re.compile(b"[ADF]")  # whose bodies show whether they are such messages
DATA_APPENDED = 1  # the only incompatible flag that this reader knows
LARGEST_BODY = 0xFFFF
DEEPEST = 8  # levels of formats within formats
MOST_FIELDS = 1_000_000  # looked at in one log; a flight takes some thousands
LONGEST_NAME = 128
# Possessive quantifiers (++) never try again with less, so garbage costs no time
FORMAT_BODY = re.compile(rb"\w{1,128}+:(?:[\w\[\]]{1,128}+ \w{1,128}+;)++", re.ASCII)
FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)", re.ASCII)

INTEGERS = [f"{sign}int{bits}_t" for bits in (8, 16, 32, 64) for sign in ("", "u")]
CODES = dict(zip((*INTEGERS, "float", "double", "bool", "char"), "bBhHiIqQfd?c", strict=True))
TIMES = ("timestamp_sample", "timestamp")  # the first that is not zero is the row's time

Row = dict[str, Any]


class Type(IntEnum):
    """The types of message that are read."""

    ROW = ord("D")
    FORMAT = ord("F")
    SUBSCRIPTION = ord("A")
    PARAMETER = ord("P")
    FLAGS = ord("B")


class Field(NamedTuple):
    """One field of a format; ``elements`` is 0 if it is no array."""

    kind: str
    elements: int
    name: str


class Found(NamedTuple):
    """A row of a topic, as it is in the file, and its time."""

    time_us: int
    topic: str
    body: bytes


UNWANTED = Found(0, "", b"")


class Table(NamedTuple):
    """Where a topic's wanted fields are in its rows; elements of arrays are ``name[0]`` ..."""

    topic: str
    names: tuple[str, ...]
    layout: Struct

    def row(self, body: bytes) -> Row:
        """The wanted fields of a row, by name."""
        return dict(zip(self.names, self.layout.unpack_from(body), strict=True))

    def found(self, body: bytes) -> Found | None:
        """A row with its time; None if it has none."""
        row = self.row(body)
        time_us = next((row[name] for name in TIMES if row.get(name)), 0)
        if not isinstance(time_us, int) or not 0 < time_us < LATEST_US:
            return None
        return Found(time_us, self.topic, body)


class UlogReader:
    """Reads a ULog's definitions and finds the rows of the topics in ``wanted``.

    ``wanted`` gives the topics' fields, of which only those of the first instance are kept. As far
    as it has been read there are ``tables`` by topic, and ``parameters`` as they were at the start.
    """

    def __init__(self, window: Window, wanted: Mapping[str, frozenset[str]]) -> None:
        self.tables: dict[str, Table] = {}
        self.parameters: dict[str, float] = {}
        self._window = window
        self._data = window.data
        self._wanted = wanted
        self._formats: dict[str, tuple[Field, ...]] = {}
        self._sizes: dict[str, int] = {}
        self._fields_seen = 0
        self._subscribed: dict[int, Table | None] = {}  # by number; None for topics not wanted
        self._row_sizes: dict[int, range] = {}
        # where in the file data were appended: a message may end short of it
        self._breaks: list[int] = []

    def rows(self) -> Iterator[Found | None]:
        """The rows in the file's order; None for each damaged stretch.

        Raises:
            ValueError: the log says that it takes a newer reader, or its definitions never end.
        """
        position = FILE_HEAD_SIZE
        while True:
            if self._window.is_near_end(position):
                position = self._window.move(position)
                self._data = self._window.data
                continue
            if position >= len(self._data):
                return
            end = self._end(position)
            cut = self._cut(position, end) if self._breaks else None
            if cut is not None:
                position = cut
            elif end is not None and self._begins_message(end):
                kind = self._data[position + 2]
                if kind == Type.ROW:
                    row = self._row(position + HEAD.size, end)
                    if row is not UNWANTED:
                        yield row
                elif not self._take(kind, position + HEAD.size, end):
                    yield None
                position = end
            else:
                yield None
                position = self._next_sound(position)

    def _cut(self, position: int, end: int | None) -> int | None:
        """Where data were appended before the message at ``position`` ends; None if nowhere."""
        stop = len(self._data) if end is None else end
        cuts = [
            at - self._window.offset
            for at in self._breaks
            if position < at - self._window.offset < stop
        ]
        return min(cuts, default=None)

    def _end(self, position: int) -> int | None:
        """Where the message at ``position`` ends; None if there is none, or not all of it."""
        if position + HEAD.size > len(self._data):
            return None
        size, kind = HEAD.unpack_from(self._data, position)
        end = position + HEAD.size + int(size)
        return end if size and kind in KNOWN_TYPES and end <= len(self._data) else None

    def _begins_message(self, position: int) -> bool:
        if position + HEAD.size > len(self._data):
            return True  # the data end here, and nothing says otherwise
        is_break = position + self._window.offset in self._breaks or self._is_another_log(position)
        return is_break or self._data[position + 2] in KNOWN_TYPES

    def _is_another_log(self, position: int) -> bool:
        """Whether another log is behind this one, with times of its own."""
        return self._data[position : position + len(MAGIC)] == MAGIC

    def _next_sound(self, position: int) -> int:
        """Where to go on behind damage: at the next sure message, or the data's end."""
        if self._is_another_log(position):
            self._window.end()
            return len(self._data)
        found = self._window.find(position + 1, self._next_telling)
        self._data = self._window.data
        return found

    def _next_telling(self, position: int) -> int | None:
        """Where the next message is that shows by its body that it is one."""
        self._data = self._window.data
        for found in TELLING_TYPES.finditer(self._data, position + 2):
            start = found.start() - 2
            if self._window.is_near_end(start):
                return None
            end = self._end(start)
            if end is not None and self._is_sound(start, end) and self._begins_message(end):
                return start
        return None

    def _is_sound(self, position: int, end: int) -> bool:
        data, start = self._data, position + HEAD.size
        match data[position + 2]:
            case Type.ROW:
                return end - start - 2 in self._row_sizes.get(_number(data, start), ())
            case Type.SUBSCRIPTION:
                is_short = end - start <= 3 + LONGEST_NAME
                return is_short and data[start + 3 : end].decode("latin-1") in self._formats
            case _:
                return FORMAT_BODY.fullmatch(data, start, end) is not None

    def _take(self, kind: int, start: int, end: int) -> bool:
        """Take in a message; False if it is damaged."""
        data = self._data
        try:
            match kind:
                case Type.FORMAT:
                    return self._format(data[start:end])
                case Type.SUBSCRIPTION:
                    number = _number(data, start + 1)
                    return self._subscribe(data[start], number, data[start + 3 : end])
                case Type.PARAMETER if not self._subscribed:  # a later one is a change
                    return self._parameter(data[start:end])
                case Type.FLAGS:
                    return self._flags(data[start:end])
        except (error, IndexError, UnicodeDecodeError):
            return False
        return True

    def _row(self, start: int, end: int) -> Found | None:
        """The row in a message; UNWANTED if it is of no use, None if it is damaged."""
        number = _number(self._data, start)
        if end - start - 2 not in self._row_sizes.get(number, ()):
            return None
        table = self._subscribed[number]
        if table is None:
            return UNWANTED
        try:
            return table.found(self._data[start + 2 : end])
        except error:  # shorter than what is wanted of it
            return None

    def _format(self, body: bytes) -> bool:
        if FORMAT_BODY.fullmatch(body) is None:
            return False
        name, _, text = body.decode("ascii").partition(":")
        matches = [FIELD.fullmatch(each) for each in text.rstrip(";").split(";")]
        fields = tuple(Field(each[1], int(each[2] or 0), each[3]) for each in matches if each)
        if len(fields) < len(matches):
            return False
        return self._formats.setdefault(name, fields) == fields

    def _subscribe(self, instance: int, number: int, body: bytes) -> bool:
        name = body.decode("ascii")
        size = self._size(name)
        if size is None:
            return False
        self._row_sizes[number] = range(size - self._padding(name), size + 1)
        self._subscribed[number] = None
        if name in self._wanted and instance == 0:
            if name not in self.tables:
                self.tables[name] = self._table(name, self._wanted[name])
            self._subscribed[number] = self.tables[name]
        return True

    def _table(self, name: str, wanted: frozenset[str]) -> Table:
        names: list[str] = []
        codes: list[str] = []
        needed = 0  # how much of the row: up to the last wanted field, the rest may be missing
        for kind, elements, field in self._fields(name):
            if field in wanted and kind in CODES:
                names += [f"{field}[{k}]" for k in range(elements)] if elements else [field]
                codes.append(f"{elements or 1}{CODES[kind]}")
                needed = len(codes)
            else:
                codes.append(f"{(self._size(kind) or 0) * (elements or 1)}x")
        return Table(name, tuple(names), Struct("<" + "".join(codes[:needed])))

    def _padding(self, name: str) -> int:
        """Bytes at the end of a row that may be left out."""
        last = self._formats[name][-1]
        if not last.name.startswith("_padding"):
            return 0
        return (self._size(last.kind) or 0) * (last.elements or 1)

    def _size(self, kind: str, depth: int = 0) -> int | None:
        """Bytes of a type; None if it is unknown, within itself, or longer than a message."""
        if kind in CODES:
            return Struct("<" + CODES[kind]).size
        if depth >= DEEPEST or kind not in self._formats:
            return None
        if kind not in self._sizes:
            fields = self._fields(kind)
            parts = [(self._size(each.kind, depth + 1), each.elements or 1) for each in fields]
            known = [size * count for size, count in parts if size is not None]
            if len(known) < len(parts) or sum(known) > LARGEST_BODY:
                return None
            self._sizes[kind] = sum(known)
        return self._sizes[kind]

    def _fields(self, name: str) -> tuple[Field, ...]:
        fields = self._formats[name]
        self._fields_seen += len(fields)
        if self._fields_seen > MOST_FIELDS:
            raise ValueError("its definitions are out of all proportion")
        return fields

    def _parameter(self, body: bytes) -> bool:
        size = body[0]
        kind, _, name = body[1 : 1 + size].decode("ascii").partition(" ")
        if kind in ("int32_t", "float"):
            (value,) = Struct("<" + CODES[kind]).unpack(body[1 + size :])
            self.parameters[name] = float(value)
        return kind in ("int32_t", "float")

    def _flags(self, body: bytes) -> bool:
        *incompatible, first, second, third = Struct("<8x8B3Q").unpack_from(body)
        if incompatible[0] & ~DATA_APPENDED or any(incompatible[1:]):
            raise ValueError("it is of a kind that is not known here")
        if incompatible[0] & DATA_APPENDED:
            self._breaks = [first, second, third]
        return True


def _number(data: bytes, position: int) -> int:
    return int.from_bytes(data[position : position + 2], "little")
