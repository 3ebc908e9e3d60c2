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
from contextlib import suppress
from struct import Struct, error
from typing import Any, NamedTuple

import numpy as np

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
TIMES = ("timestamp_sample", "timestamp")

Row = dict[str, Any]


class Found(NamedTuple):
    """A row of a topic, and its time; the fields are numbers, or arrays of them."""

    time_us: int
    topic: str
    row: Row


class Table(NamedTuple):
    """A topic, and where the times and the wanted fields are in its rows."""

    topic: str
    layout: np.dtype[Any]

    def found(self, data: bytes, position: int) -> Found | None:
        """The row at ``position``; None if it has no time."""
        size = self.layout.itemsize
        if position + size > len(data):  # the last row may lack its padding
            data, position = data[position:].ljust(size), 0
        numbers = np.ndarray((), self.layout, data, position).item()
        row = dict(zip(self.layout.names or (), numbers, strict=True))
        time_us = row.get("timestamp_sample") or row.get("timestamp", 0)
        is_time = isinstance(time_us, int) and 0 < time_us < LATEST_US
        return Found(time_us, self.topic, row) if is_time else None


NO_ROWS: tuple[range, Table | None] = range(0), None


class UlogReader:
    """Reads a ULog's definitions and finds the rows of the topics in ``wanted``.

    ``wanted`` gives the topics' fields, of which only those of the first instance are kept. As far
    as it has been read there are ``tables`` by topic, and ``parameters`` as they were at the start.
    """

    def __init__(self, window: Window, wanted: Mapping[str, frozenset[str]]) -> None:
        self.tables: dict[str, Table] = {}
        self.parameters: dict[str, float] = {}
        self._window, self._wanted = window, wanted
        self._formats: dict[str, list[tuple[str, str, int]]] = {}  # name, type, elements
        self._types: dict[str, np.dtype[Any] | None] = {
            kind: np.dtype("<" + code) for kind, code in CODES.items()
        }
        # by number: the sizes that a row may have, and its table; None for topics not wanted
        self._subscribed: dict[int, tuple[range, Table | None]] = {}

    def rows(self) -> Iterator[Found | None]:
        """The rows in the file's order; None for each damaged stretch.

        Raises:
            ValueError: the log needs a newer reader.
        """
        return self._window.records(FILE_HEAD_SIZE, self._read, self._next_message)

    def _read(self, position: int) -> tuple[tuple[Found | None, ...], int] | None:
        """The row of the message at ``position``, if it has one, and where that ends."""
        data = self._window.data
        if (end := self._end(data, position)) is None:
            if not data.startswith(MAGIC, position):
                return None
            self._window.end()  # another log is behind this one, with times of its own
            return (None,), len(data)
        kind, start = data[position + 2], position + HEAD.size
        if kind != ROW:
            return () if self._takes(kind, data[start:end]) else (None,), end
        sizes, table = self._subscribed.get(_number(data, start), NO_ROWS)
        if end - start - NUMBER_SIZE not in sizes:
            return (None,), end
        return () if table is None else (table.found(data, start + NUMBER_SIZE),), end

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
        fields = [(each[3], each[1], int(each[2] or 0)) for each in matches if each]
        return len(fields) == len(matches) and self._formats.setdefault(name, fields) == fields

    def _subscribe(self, instance: int, number: int, name: str) -> bool:
        row = self._type(name)
        if row is None or row.fields is None:
            return False
        size, last = row.itemsize, self._formats[name][-1][0]
        least = row.fields[last][1] if last.startswith("_padding") else size  # it may be left out
        if name in self._wanted and instance == 0 and name not in self.tables:
            wanted = {*TIMES, *self._wanted[name]}
            plain = [each for each in row.fields if row[each].base.names is None]
            self.tables[name] = Table(name, row[[each for each in plain if each in wanted]])
        table = self.tables.get(name) if instance == 0 else None
        self._subscribed[number] = range(least, size + 1), table
        return True

    def _type(self, kind: str) -> np.dtype[Any] | None:
        """A type; None if it is unknown, within itself, or longer than a message.

        A format is looked at once, and one within itself is unknown meanwhile.
        """
        if kind not in self._types and kind in self._formats:
            self._types[kind] = None
            fields = [(n, self._type(k), elements) for n, k, elements in self._formats[kind]]
            known = [
                (name, each, number or ()) for name, each, number in fields if each is not None
            ]
            with suppress(ValueError):  # two fields of one name, or more than numpy counts
                made = np.dtype(known)
                is_whole = len(known) == len(fields) and made.itemsize <= LARGEST_BODY
                self._types[kind] = made if is_whole else None
        return self._types.get(kind)

    def _parameter(self, body: bytes) -> bool:
        size = body[0]
        kind, _, name = body[1 : 1 + size].decode("ascii").partition(" ")
        if kind in ("int32_t", "float"):
            (value,) = Struct("<" + CODES[kind]).unpack(body[1 + size :])
            self.parameters[name] = float(value)
        return kind in ("int32_t", "float")


def _number(data: bytes, position: int) -> int:
    return int.from_bytes(data[position : position + NUMBER_SIZE], "little")
