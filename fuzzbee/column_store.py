"""Attitudes and samples as rows of numbers, in a tenth of the room that as many tuples take."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import Any, Generic, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from drivers.logs.spill_file import SpillFile, blocks
from estimator.arrays import Floats
from estimator.live.rows import NORTHS
from estimator.types import Attitude, ImuSample

Row = TypeVar("Row", Attitude, ImuSample)
PLACE = {north: float(place) for place, north in enumerate(NORTHS)}


class Columns(NamedTuple):
    """Where the fields behind ``time_us`` stand in a row: those of several numbers, then others."""

    vectors: dict[str, slice]
    numbers: dict[str, int]

    @property
    def width(self) -> int:
        """Numbers in a row."""
        return max(self.numbers.values()) + 1


def columns(kind: Any, **widths: int) -> Columns:
    """Of a named tuple whose fields of several numbers, so many, come right behind the time."""
    names = kind._fields[1:]
    ends = np.cumsum([0, *widths.values()]).tolist()
    vectors = {n: slice(a, b) for n, a, b in zip(widths, ends, ends[1:], strict=False)}
    assert tuple(vectors) == names[: len(vectors)]
    return Columns(vectors, {n: ends[-1] + k for k, n in enumerate(names[len(vectors) :])})


class Packed(Sequence[Row], Generic[Row]):
    """A growing sequence of named tuples."""

    kind: type[Row]
    columns: Columns

    def __init__(self, rows: Iterable[Row] = ()) -> None:
        self._times_us, self._values = SpillFile("q"), SpillFile("d", self.columns.width)
        for row in rows:
            self.append(row)

    def append(self, row: Row) -> None:
        """One more."""
        self._times_us.extend(row[:1])
        fields: Any = row[1:]
        vectors = len(self.columns.vectors)
        self._values.extend(chain(*fields[:vectors], self._coded(fields[vectors:])))

    def __len__(self) -> int:
        return len(self._times_us)

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> list[Row]: ...
    def __getitem__(self, at: int | slice) -> Row | list[Row]:
        if isinstance(at, slice):
            return [self[k] for k in range(len(self))[at]]
        row = slice(range(len(self))[at], range(len(self))[at] + 1)
        (values,) = self._values.rows(row).tolist()
        vectors = (tuple(values[part]) for part in self.columns.vectors.values())
        rest = self._decoded(values[min(self.columns.numbers.values()) :])
        (time_us,) = self._times_us.rows(row).tolist()
        return self.kind(time_us, *vectors, *rest)  # type: ignore[arg-type]

    @property
    def times_us(self) -> NDArray[np.int64]:
        """Times (N,)."""
        return self._times_us.rows()

    def times_of(self, rows: slice) -> NDArray[np.int64]:
        """Times (N,) of some rows."""
        return self._times_us.rows(rows)

    def steps_s(self) -> Iterator[Floats]:
        """Times between rows that follow each other, in parts."""
        return (1e-6 * part for part in self._times_us.steps())

    def within(self, rows: slice, margin_s: float) -> slice:
        """These rows and those that are less than ``margin_s`` away from them."""
        first_us, last_us = self.times_of(rows)[[0, -1]].tolist()
        margin_us = 1e6 * margin_s
        first, behind = first_us - margin_us, last_us + margin_us
        return slice(self._times_us.first_from(first), self._times_us.first_from(behind))

    def column(self, name: str, rows: slice = slice(None)) -> Floats:
        """The numbers of a field, (N,) or (N, K), or of some rows of it."""
        at: Any = self.columns.numbers.get(name, self.columns.vectors.get(name))
        first, behind, _ = rows.indices(len(self))
        found = np.empty((max(behind - first, 0), *self._values.rows(slice(0))[:, at].shape[1:]))
        for part in blocks(len(found)):
            wanted = slice(first + part.start, first + part.stop)
            found[part] = self._values.rows(wanted)[:, at]
        return found

    def _coded(self, rest: Any) -> Any:
        """The last fields as numbers."""
        return rest

    def _decoded(self, values: list[float]) -> Any:
        """These as fields."""
        return values


class PackedSamples(Packed[ImuSample]):
    """Readings."""

    kind = ImuSample
    columns = columns(ImuSample, gyr_rad_s=3, acc_m_s2=3, mag_gauss=3)

    def _decoded(self, values: list[float]) -> Any:
        return (bool(values[0]),)


class PackedAttitudes(Packed[Attitude]):
    """Attitudes."""

    kind = Attitude
    columns = columns(Attitude, q_ned_frd=4, rate_rad_s=3, gyro_bias_rad_s=3)

    def norths(self, rows: slice = slice(None)) -> NDArray[np.str_]:
        """What the headings (N,) are measured from."""
        return np.array(NORTHS)[self.north_places(rows)]

    def north_places(self, rows: slice = slice(None)) -> NDArray[np.uint8]:
        """Where those stand in ``NORTHS`` (N,): a word takes 32 bytes."""
        return self.column("heading_reference", rows).astype(np.uint8)

    def replace(self, name: str, values: Floats) -> None:
        """Put other numbers, (N,) or (N, K), into a field."""
        at: Any = self.columns.numbers.get(name, self.columns.vectors.get(name))
        for part in blocks(len(self)):
            rows = self._values.rows(part)
            rows[:, at] = values[part]
            self._values.write(part.start, rows)

    def _coded(self, rest: Any) -> Any:
        return (*rest[:-1], PLACE[rest[-1]])

    def _decoded(self, values: list[float]) -> Any:
        return (*values[:-1], NORTHS[int(values[-1])])
