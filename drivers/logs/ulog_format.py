"""PX4's ULog format: messages, the topics they belong to, and where their rows are.

A message is its size (16 bits), its type (a letter) and a body. F gives a format its fields,
A gives a number to a topic, D is a row of the topic of that number, P a parameter
(https://docs.px4.io/main/en/dev_log/ulog_file_format.html).

What the file claims is never believed further than it reaches: no format is unrolled but for
the fields that are wanted, and the reading goes forwards only, in pieces, and keeps nothing but
definitions. After damage it goes on with the next message that cannot be an accident.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from struct import Struct, calcsize, error
from typing import Any, NamedTuple

from drivers.logs.log_file import LATEST_US, Window

MAGIC = b"ULog\x01\x12\x35"
FILE_HEAD_SIZE = 16
HEAD = Struct("<HB")
NUMBER_SIZE = 2
ROW, FORMAT, SUBSCRIPTION, PARAMETER, FLAGS = b"DFAPB"
KNOWN_TYPES = frozenset(b"ABCDFILMOPQRS")
DISTINCT_TYPES = re.compile(b"[ADF]")  # whose bodies show whether they are such messages
DATA_APPENDED = 1  # the only incompatible flag that is known here; what it cuts off is damage
LARGEST_BODY = 0xFFFF
LONGEST_NAME = 128
# Possessive quantifiers (++) never try again with less, so garbage costs no time
FORMAT_BODY = re.compile(rb"\w{1,128}+:(?:[\w\[\]]{1,128}+ \w{1,128}+;)++", re.ASCII)
FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)", re.ASCII)

INTEGERS = [f"{sign}int{bits}_t" for bits in (8, 16, 32, 64) for sign in ("", "u")]
CODES = dict(zip((*INTEGERS, "float", "double", "bool", "char"), "bBhHiIqQfd?c", strict=True))
TIMES = ("timestamp_sample", "timestamp")  # the first that is not zero is the row's time

Row = dict[str, Any]


class Field(NamedTuple):
    """One field of a format; ``elements`` is 0 if it is no array."""

    kind: str
    elements: int
    name: str


class Found(NamedTuple):
    """A row of a topic, and its time; the fields are numbers, or tuples of them."""

    time_us: int
    topic: str
    row: Row


class Table(NamedTuple):
    """Where the times and the wanted fields of a topic are in its rows."""

    topic: str
    layout: Struct
    times: tuple[int, ...]  # among the numbers of the layout
    fields: tuple[tuple[str, int | slice], ...]

    def found(self, data: bytes, position: int) -> Found | None:
        """The row at ``position``; None if it has no time."""
        numbers, time_us = self.layout.unpack_from(data, position), 0
        for place in self.times:
            time_us = time_us or numbers[place]
        if not 0 < time_us < LATEST_US:
            return None
        return Found(time_us, self.topic, {name: numbers[place] for name, place in self.fields})


NO_ROWS: tuple[range, Table | None] = range(0), None


class UlogReader:
    """Reads a ULog's definitions and finds the rows of the topics in ``wanted``.

    ``wanted`` gives the topics' fields, of which only those of the first instance are kept. As far
    as it has been read there are ``tables`` by topic, and ``parameters`` as they were at the start.
    """

    def __init__(self, window: Window, wanted: Mapping[str, Collection[str]]) -> None:
        self.tables: dict[str, Table] = {}
        self.parameters: dict[str, float] = {}
        self._window, self._wanted = window, wanted
        self._formats: dict[str, tuple[Field, ...]] = {}
        self._sizes: dict[str, int | None] = {k: calcsize("<" + c) for k, c in CODES.items()}
        # by number: the sizes that a row may have, and its table; None for topics not wanted
        self._subscribed: dict[int, tuple[range, Table | None]] = {}

    def rows(self) -> Iterator[Found | None]:
        """The rows in the file's order; None for each damaged stretch.

        Raises:
            ValueError: the log needs a newer reader.
        """
        return self._window.records(FILE_HEAD_SIZE, self._read, self._next_message)

    def _read(self, position: int) -> tuple[int, Sequence[Found | None]]:
        """Where the message at ``position`` ends, and its row, if it is one."""
        data = self._window.data
        end = self._end(data, position)
        if end is None:
            if not data.startswith(MAGIC, position):
                return position, ()
            self._window.end()  # another log is behind this one, with times of its own
            return len(data), (None,)
        start = position + HEAD.size
        if data[position + 2] != ROW:
            return end, () if self._takes(data[position + 2], data[start:end]) else (None,)
        sizes, table = self._subscribed.get(_number(data, start), NO_ROWS)
        if end - start - NUMBER_SIZE not in sizes:
            return end, (None,)
        return end, () if table is None else (table.found(data, start + NUMBER_SIZE),)

    @staticmethod
    def _end(data: bytes, position: int) -> int | None:
        """Where the message at ``position`` ends, with another one or the data's end behind it."""
        if position + HEAD.size > len(data):
            return None
        size, kind = HEAD.unpack_from(data, position)
        end: int = position + HEAD.size + size
        if not size or kind not in KNOWN_TYPES or end > len(data):
            return None
        is_last = end + HEAD.size > len(data) or data.startswith(MAGIC, end)
        return end if is_last or data[end + 2] in KNOWN_TYPES else None

    def _next_message(self, position: int) -> int | None:
        """Where the next message is that shows by its body that it is one."""
        data = self._window.data
        for found in DISTINCT_TYPES.finditer(data, position + 2):
            start = found.start() - 2
            end = self._end(data, start)
            if end is not None and self._is_sound(data, start, end):
                return start
        return None

    def _is_sound(self, data: bytes, position: int, end: int) -> bool:
        kind, start = data[position + 2], position + HEAD.size
        if kind == ROW:
            sizes, _ = self._subscribed.get(_number(data, start), NO_ROWS)
            return end - start - NUMBER_SIZE in sizes
        if kind == FORMAT:
            return FORMAT_BODY.fullmatch(data, start, end) is not None
        is_short = end - start <= 3 + LONGEST_NAME
        return is_short and data[start + 3 : end].decode("latin-1") in self._formats

    def _takes(self, kind: int, body: bytes) -> bool:
        """Take in a message; False if it is damaged."""
        try:
            if kind == FORMAT:
                return self._format(body)
            if kind == SUBSCRIPTION:
                return self._subscribe(body[0], _number(body, 1), body[3:].decode("ascii"))
            if kind == PARAMETER and not self._subscribed:  # a later one is a change
                return self._parameter(body)
            if kind == FLAGS:
                known, *others = Struct("<8x8B").unpack_from(body)
                if known & ~DATA_APPENDED or any(others):
                    raise ValueError("it is of a kind that is not known here")
        except (error, IndexError, UnicodeDecodeError, RecursionError):
            return False
        return True

    def _format(self, body: bytes) -> bool:
        if FORMAT_BODY.fullmatch(body) is None:
            return False
        name, _, text = body.decode("ascii").partition(":")
        matches = [FIELD.fullmatch(each) for each in text.rstrip(";").split(";")]
        fields = tuple(Field(each[1], int(each[2] or 0), each[3]) for each in matches if each)
        return len(fields) == len(matches) and self._formats.setdefault(name, fields) == fields

    def _subscribe(self, instance: int, number: int, name: str) -> bool:
        size = self._size(name)
        if size is None or name not in self._formats:
            return False
        last = self._formats[name][-1]  # padding at a row's end may be left out
        padding = self._bytes(last) if last.name.startswith("_padding") else 0
        if name in self._wanted and instance == 0 and name not in self.tables:
            self.tables[name] = self._table(name, self._wanted[name])
        table = self.tables.get(name) if instance == 0 else None
        self._subscribed[number] = range(size - padding, size + 1), table
        return True

    def _table(self, topic: str, wanted: Collection[str]) -> Table:
        layout, end, count = "<", 1, 0  # what is behind the last wanted field may be missing
        times: dict[str, int] = {}
        fields: list[tuple[str, int | slice]] = []
        for field in self._formats[topic]:
            kind, elements, name = field
            if name in TIMES and kind in INTEGERS and not elements:
                times[name] = count
            elif name in wanted and kind in CODES:
                fields.append((name, slice(count, count + elements) if elements else count))
            else:
                layout += f"{self._bytes(field)}x"
                continue
            count += elements or 1
            layout += f"{elements or 1}{CODES[kind]}"
            end = len(layout)
        in_order = tuple(times[name] for name in TIMES if name in times)
        return Table(topic, Struct(layout[:end]), in_order, tuple(fields))

    def _bytes(self, field: Field) -> int:
        return (self._size(field.kind) or 0) * (field.elements or 1)

    def _size(self, kind: str) -> int | None:
        """Bytes of a type; None if it is unknown, within itself, or longer than a message.

        A format is looked at once, and one within itself is unknown meanwhile.
        """
        if kind not in self._sizes and kind in self._formats:
            self._sizes[kind] = None
            fields = self._formats[kind]
            if all(self._size(each.kind) is not None for each in fields):
                size = sum(self._bytes(each) for each in fields)
                self._sizes[kind] = size if size <= LARGEST_BODY else None
        return self._sizes.get(kind)

    def _parameter(self, body: bytes) -> bool:
        size = body[0]
        kind, _, name = body[1 : 1 + size].decode("ascii").partition(" ")
        if kind in ("int32_t", "float"):
            (value,) = Struct("<" + CODES[kind]).unpack(body[1 + size :])
            self.parameters[name] = float(value)
        return kind in ("int32_t", "float")


def _number(data: bytes, position: int) -> int:
    return int.from_bytes(data[position : position + NUMBER_SIZE], "little")
