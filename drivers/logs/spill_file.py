"""Rows of numbers kept of a log, which may be larger than the memory."""

import os
from array import array
from collections.abc import Iterable, Iterator
from tempfile import TemporaryFile
from typing import Any, Literal
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[Any]

PIECE = 1 << 19  # numbers that are put away at once
BLOCK = 50_000  # rows that are worked on at once


def blocks(n: int) -> Iterator[slice]:
    """The rows from 0 to n, ``BLOCK`` at a time."""
    return (slice(begin, min(begin + BLOCK, n)) for begin in range(0, n, BLOCK))


class SpillFile:
    """A growing table (N, width), or (N,) of width 1: flags, whole numbers or floats.

    What is more than a piece goes into a file without a name, in the folder for temporary ones.
    Where none can be written, it stays in memory.
    """

    def __init__(self, code: Literal["b", "q", "d"], width: int = 1) -> None:
        self._width = width
        self._kind = np.dtype(code)
        self._last: array[Any] = array(code)
        self._in_file = 0  # rows
        self._file: Any = None
        self._has_room = True

    def extend(self, numbers: Iterable[Any]) -> None:
        """Whole rows more, one number after the other."""
        self._last.extend(numbers)
        if len(self._last) >= PIECE and self._has_room:
            self._put_away()

    def add(self, rows: Numbers) -> None:
        """Rows (M, width) more."""
        self.extend(array(self._last.typecode, np.asarray(rows, self._kind).tobytes()))

    def __len__(self) -> int:
        return self._in_file + len(self._last) // self._width

    def rows(self, part: slice = slice(None)) -> Numbers:
        """A copy of the rows from ``part.start`` up to ``part.stop``."""
        first, behind, _ = part.indices(len(self))
        n = self._in_file
        last = self._last[max(first - n, 0) * self._width : max(behind - n, 0) * self._width]
        found = np.frombuffer(last, self._kind)
        if first < min(behind, n):
            self._file.seek(first * self._width * self._kind.itemsize)
            count = (min(behind, n) - first) * self._width
            found = np.concatenate([np.fromfile(self._file, self._kind, count), found])
        return found if self._width == 1 else found.reshape(-1, self._width)

    @property
    def latest(self) -> Any:
        """The last number; there is one."""
        return self._last[-1] if self._last else self.rows(slice(-1, None))[-1]

    def parts(self) -> Iterator[Numbers]:
        """All rows, ``BLOCK`` at a time."""
        return (self.rows(part) for part in blocks(len(self)))

    def steps(self) -> Iterator[Numbers]:
        """The differences between rows that follow each other, in parts."""
        return (np.diff(self.rows(slice(max(k.start - 1, 0), k.stop))) for k in blocks(len(self)))

    def write(self, first: int, rows: Numbers) -> None:
        """Put other rows (M, width) in the places from ``first`` on."""
        numbers = array(self._last.typecode, np.asarray(rows, self._kind).tobytes())
        begin = (first - self._in_file) * self._width
        if begin < 0:
            self._write(first * self._width * self._kind.itemsize, numbers[:-begin])
            numbers, begin = numbers[-begin:], 0
        self._last[begin : begin + len(numbers)] = numbers

    def first_from(self, value: float) -> int:
        """Of an ascending column the first row that is not below ``value``."""
        low, high = 0, len(self)
        while low < high:
            middle = (low + high) // 2
            is_below = self.rows(slice(middle, middle + 1))[0] < value
            low, high = (middle + 1, high) if is_below else (low, middle)
        return low

    def _put_away(self) -> None:
        try:
            if self._file is None:
                self._file = TemporaryFile(buffering=0)  # noqa: SIM115 - closed with the table
                finalize(self, self._file.close)
            self._write(self._in_file * self._width * self._kind.itemsize, self._last)
        except OSError:
            self._has_room = False
            return
        self._in_file = len(self)
        del self._last[:]

    def _write(self, at: int, numbers: "array[Any]") -> None:
        data = memoryview(numbers).cast("B")
        while data:
            written = os.pwrite(self._file.fileno(), data, at)
            data, at = data[written:], at + written
