"""A table as text: its encoding, delimiter and decimal sign, and what its columns are called.

Nothing of it is agreed upon between programs, so the first rows of numbers show: what stands right
above them, in as many fields, is the heading.
"""

import codecs
import csv
import os
import re
from collections.abc import Iterator, Sequence
from datetime import datetime
from functools import partial
from math import isnan, nan
from pathlib import Path
from typing import NamedTuple

from drivers.logs.log_file import READ_SIZE, OnRead
from estimator.errors import InputError

HEAD_SIZE = 65_536  # bytes that show how a table is written
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
DELIMITERS = (",", ";", "\t", "|", " ")
HEADING_LINES = 3  # sensors, axes and units may have a line each
LEAST_NUMBERS = 6  # three rates, three accelerations; a time may be in words
LINE_END = re.compile("\r\n|\r|\n")
LONGEST_LINE = 65_536
THOUSANDS = re.compile(r"\.(?=\d{3}[.,])")  # beside a decimal comma
BLANKS = frozenset(("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "?"))


class CsvText(NamedTuple):
    """How a table is written; ``names`` has of each column the texts above it, top first."""

    encoding: str
    delimiter: str
    has_decimal_comma: bool
    lines_above: int
    names: tuple[tuple[str, ...], ...]
    first: tuple[str, ...] = ()  # the fields of the first row
    numbers: int = 0  # of them

    def titles(self) -> list[str]:
        """The columns' names for a person; numbers from 1 where there is no heading."""
        return [" ".join(filter(None, name)) or str(k) for k, name in enumerate(self.names, 1)]


def csv_text(head: bytes) -> CsvText | None:
    """How the table that begins with ``head`` is written; None if it is no table of numbers."""
    encoding = "utf-8-sig"
    if head.startswith(UTF_16):
        encoding = "utf-16"
    else:
        try:  # the last character may be cut
            codecs.getincrementaldecoder("utf-8")().decode(head)
        except UnicodeDecodeError:
            encoding = "cp1252"
    lines = LINE_END.split(head.decode(encoding, errors="replace"))
    found = [text for each in DELIMITERS if (text := _delimited(lines, encoding, each))]
    return max(found, key=lambda text: text.numbers, default=None)


def csv_rows(path: Path, text: CsvText, on_read: OnRead | None = None) -> Iterator[list[str]]:
    """The rows below the heading as lists of fields.

    ``on_read`` is called now and then with the number of the file's bytes that have been read.

    Raises:
        InputError: the file cannot be read.
    """
    unreported = 0
    try:
        with path.open(encoding=text.encoding, errors="replace", newline="") as file:
            for number, line in enumerate(iter(partial(file.readline, LONGEST_LINE), "")):
                unreported += len(line)
                if on_read is not None and unreported > READ_SIZE:
                    unreported = 0
                    on_read(os.lseek(file.fileno(), 0, os.SEEK_CUR))
                if number >= text.lines_above and (row := _fields(line, text.delimiter)):
                    yield row
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _fields(line: str, delimiter: str) -> list[str]:
    """A line's fields, none of an empty one."""
    text = line.strip(" \r\n").lstrip("# ")
    return next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])


def _delimited(lines: Sequence[str], encoding: str, delimiter: str) -> CsvText | None:
    """The table with that delimiter, from its first row of numbers on."""
    rows = [_fields(line, delimiter) for line in lines]
    for k, row in enumerate(rows):
        comma = any("," in each and is_number(each, comma=True) for each in row)
        numbers, blanks = _count(row, comma=comma)
        if numbers < LEAST_NUMBERS or 2 * (numbers + blanks) < len(row):
            continue
        below = next(filter(None, rows[k + 1 :]), row)
        if len(below) > LEAST_NUMBERS and not _count(below, comma=comma)[0]:
            continue  # the heading is below, these are of a calibration
        first = _first_row(rows, k, comma=comma)
        heading: list[list[str]] = []
        for each in [*filter(None, rows[:first])][: -HEADING_LINES - 1 : -1]:
            if abs(len(each) - len(row)) > 1 or any(is_number(f, comma=comma) for f in each):
                break
            # without a name are a row's number before it, or an empty field behind it
            is_numbered = len(each) < len(row) and row[-1].strip() != ""
            heading.insert(0, ["", *each] if is_numbered else [*each, ""])
        names = tuple(
            tuple(each[i].strip() if i < len(each) else "" for each in heading)
            for i in range(len(row))
        )
        return CsvText(encoding, delimiter, comma, first, names, tuple(rows[first]), numbers)
    return None


def _first_row(rows: Sequence[Sequence[str]], k: int, *, comma: bool) -> int:
    """Where the rows of numbers begin: those before row ``k`` may lack readings."""
    while k and len(rows[k - 1]) == len(rows[k]):
        numbers, blanks = _count(rows[k - 1], comma=comma)
        if not numbers or numbers + blanks < len(rows[k]):
            break
        k -= 1
    return k


def _count(row: Sequence[str], *, comma: bool) -> tuple[int, int]:
    """How many numbers or dates, and blanks, are among the fields."""
    numbers = sum(is_number(each, comma=comma) or is_date(each) for each in row)
    return numbers, sum(each.strip().lower() in BLANKS for each in row)


def is_date(field: str) -> bool:
    """Whether a field is a date with its time, as ISO 8601 has them."""
    try:
        datetime.fromisoformat(field.strip())
    except ValueError:
        return False
    return ":" in field


def is_number(field: str, *, comma: bool) -> bool:
    """Whether a field is a number, with a decimal ``comma`` or without."""
    try:
        return not isnan(as_number(field, comma))
    except ValueError:
        return False


def as_number(field: str, comma: bool) -> float:
    """A field as a number, with a decimal ``comma`` or without; NaN for an empty one.

    Raises:
        ValueError: it is something else.
    """
    if comma:
        field = (THOUSANDS.sub("", field) if "," in field else field).replace(",", ".")
    try:
        return float(field)
    except ValueError:
        if field.strip().lower() in BLANKS:
            return nan
        raise
