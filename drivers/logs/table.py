"""A table of numbers that grows row by row; what is long lies in files that are mapped."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import chain, repeat
from tempfile import TemporaryFile
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

Values = NDArray[Any]

BLOCK = 50_000  # rows that are worked on at once, where intermediate results take much memory
WAITING = 5_000  # rows that wait as Python's numbers until they go to their columns together
IN_MEMORY = 50_000  # rows of a column; with more it lies in a file


def blocks(n: int) -> Iterator[slice]:
    """The rows from 0 to n, ``BLOCK`` at a time."""
    return (slice(begin, min(begin + BLOCK, n)) for begin in range(0, n, BLOCK))


class Table:
    """Columns of equal length, each by its name a constant array (N,) or (N, K).

    ``kinds`` are the types of their rows as NumPy names them: ``f8``, or ``3f8`` for K = 3.
    """

    def __init__(self, **kinds: str) -> None:
        self._dtypes = {name: np.dtype(kind) for name, kind in kinds.items()}
        self._columns = {name: _Column() for name in kinds}
        self._waiting: list[tuple[Any, ...]] = []
        self._count = 0

    def append(self, *row: Any) -> None:
        """One row more; its vectors are tuples."""
        self._waiting.append(row)
        self._count += 1
        if len(self._waiting) >= WAITING:
            self._settle()

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, name: str) -> Values:
        self._settle()
        return self._columns[name].values

    def put(self, name: str, parts: Iterable[Values]) -> None:
        """A new column, or another in place of one; its rows come in parts."""
        self._settle()
        column = _Column()
        for part in parts:
            column.extend(part)
        self._columns[name] = column

    def _settle(self) -> None:
        if self._count and not self._waiting:
            return
        rows, self._waiting = self._waiting, []
        columns: Iterable[Any] = zip(*rows, strict=True) if rows else repeat((), len(self._dtypes))
        for (name, kind), values in zip(self._dtypes.items(), columns, strict=True):
            # a number of one after the other: NumPy takes twice as long for tuples in a list
            numbers = chain.from_iterable(values) if kind.shape else values
            self._columns[name].extend(np.fromiter(numbers, kind.base).reshape(-1, *kind.shape))


class _Column:
    """Rows in memory, and those before them in a file without a name, once they are many.

    Where no file can be written, all stay in memory.
    """

    def __init__(self) -> None:
        self._parts: list[Values] = []
        self._in_memory = self._in_file = 0  # rows
        self._file: Any = None
        self._has_room = True

    def extend(self, rows: Values) -> None:
        if len(rows) or not self._parts:
            self._parts.append(np.array(rows))
            self._in_memory += len(rows)
        if self._in_memory > IN_MEMORY:
            self._put_away()

    @property
    def values(self) -> Values:
        if self._file is not None:
            self._put_away()
        rows = self._joined()
        if self._in_file:
            shape = (self._in_file, *rows.shape[1:])
            mapped = np.asarray(np.memmap(self._file, rows.dtype, "r", shape=shape))
            rows = np.concatenate([mapped, rows]) if len(rows) else mapped
        rows.flags.writeable = False
        return rows

    def _joined(self) -> Values:
        if len(self._parts) > 1:
            self._parts = [np.concatenate(self._parts)]
        return self._parts[0]

    def _put_away(self) -> None:
        rows = self._joined()
        if not self._has_room or not len(rows):
            return
        written = 0
        with suppress(OSError):
            if self._file is None:
                self._file = TemporaryFile(buffering=0)  # noqa: SIM115 - closed with the column
                finalize(self, self._file.close)
            self._file.seek(self._in_file * rows[:1].nbytes)
            written = self._file.write(rows.tobytes())
        if written != rows.nbytes:
            self._has_room = False
            return
        self._in_file += len(rows)
        self._parts, self._in_memory = [rows[:0].copy()], 0
