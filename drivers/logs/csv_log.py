"""Tables of IMU readings as text (.csv): one row a sample, as other programs write them."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from math import isnan
from pathlib import Path
from typing import Literal

from drivers.events import COMPASS_CALIBRATED, Event, Parameter
from drivers.logs.csv_columns import Columns, Part, columns, description
from drivers.logs.csv_text import CsvText, csv_rows, csv_text
from drivers.logs.log_file import LATEST_US, LogFile
from drivers.logs.logged_vehicle import dated_vehicle
from drivers.samples.attitudes import quaternion_from_euler, unit_or_none
from drivers.samples.navigation import Fix
from estimator.errors import InputError
from estimator.geometry.frames import ned_frd_from_enu_flu
from estimator.types import Quaternion, Vec3

STREAM = "CSV"
RECEIVER = "GPS"
HEAD_SIZE = 65_536


class CsvLog(LogFile):
    """A table as events; each iteration reads the file from its start, a row at a time.

    Raises:
        InputError: the columns do not say what they are, or the description is wrong.
    """

    def __init__(self, path: Path, described: Path | None = None) -> None:
        super().__init__(path)
        with path.open("rb") as file:
            text = csv_text(file.read(HEAD_SIZE))
        if text is None:
            raise InputError(f"{path}: no table: no row has three rates and three forces")
        self._text = text
        told = description(path, described)
        try:
            self._columns = columns(text, told)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def __iter__(self) -> Iterator[Event]:
        with csv_rows(self.path, self._text, self.on_read) as rows:
            decoder: _Decoder | None = None
            for row in rows:
                time_us = None if row is None else _time_us(self._text, row, self._columns.time)
                if decoder is None:
                    decoder = _Decoder(self._text, self._columns, time_us or 0)
                    yield from decoder.head()
                yield from decoder.decode(time_us, row or [])
            if decoder is not None:
                yield from decoder.vehicle.end()


class _Decoder:
    """Rows in, events out; times count from the first row, also backwards: clocks are set."""

    def __init__(self, text: CsvText, columns: Columns, begin_us: int) -> None:
        self._text = text
        self._columns = columns
        self._begin_us = begin_us
        self.vehicle = dated_vehicle(begin_us, doubts_axes=columns.doubts_axes)
        self._is_whole = True  # whether all that was read of the row so far are numbers

    def head(self) -> list[Event]:
        """What the description says of the compass."""
        word = self._columns.compass_calibrated
        if word is None:
            return []
        return [Parameter(self.vehicle.id, self.vehicle.arrival_us, COMPASS_CALIBRATED, word)]

    def decode(self, time_us: int | None, row: Sequence[str]) -> list[Event]:
        """The events of a row; what is empty is not there, a row with no number for one counted."""
        if time_us is None:
            return [self.vehicle.malformed()]
        self.vehicle.at(time_us - self._begin_us)
        self._is_whole = True
        events = self._events(row)
        return events if self._is_whole else [*events, self.vehicle.malformed()]

    def _events(self, row: Sequence[str]) -> list[Event]:
        columns, vehicle, events = self._columns, self.vehicle, list[Event]()
        velocity, position = self._vector(row, columns.velocity), self._place(row)
        if velocity is not None or position is not None:
            events += vehicle.fix(RECEIVER, Fix(velocity, position=position))
        mag = self._vector(row, columns.magnetometer)
        if mag is not None:
            vehicle.put_mag(mag)
        gyr, acc = self._vector(row, columns.gyroscope), self._vector(row, columns.accelerometer)
        if gyr is not None and acc is not None:
            events += vehicle.imu(STREAM, gyr, acc)
        events += self._attitude(row, "truth", columns.truth)
        events += self._attitude(row, "autopilot", columns.autopilot)
        return events

    def _attitude(
        self, row: Sequence[str], name: Literal["truth", "autopilot"], parts: Sequence[Part]
    ) -> list[Event]:
        numbers = self._numbers(row, parts)
        if numbers is None:
            return []
        q = _quaternion(numbers)
        if q is not None and name in self._columns.enu_flu:
            q = ned_frd_from_enu_flu(q)
        source: Literal["autopilot", "sim"] = "sim" if name == "truth" else "autopilot"
        return self.vehicle.attitude(name, source, q)

    def _place(self, row: Sequence[str]) -> Vec3 | None:
        numbers = self._numbers(row, self._columns.position)
        if numbers is None:
            return None
        latitude_deg, longitude_deg, altitude_m = [*numbers, 0.0][:3]
        return latitude_deg, longitude_deg, altitude_m

    def _vector(self, row: Sequence[str], parts: Sequence[Part]) -> Vec3 | None:
        numbers = self._numbers(row, parts)
        return None if numbers is None else (numbers[0], numbers[1], numbers[2])

    def _numbers(self, row: Sequence[str], parts: Sequence[Part]) -> list[float] | None:
        """The numbers in those columns; None where one is empty, or is no number."""
        try:
            numbers = [factor * self._text.number(row[i]) for i, factor in parts]
        except (ValueError, IndexError):
            self._is_whole = False
            return None
        return None if not numbers or any(map(isnan, numbers)) else numbers


def _time_us(text: CsvText, row: Sequence[str], parts: Sequence[Part]) -> int | None:
    """The row's time; None if it has none that can be."""
    index, factor = parts[0]
    try:
        if factor:
            time_us = round(factor * text.number(row[index]))
        else:
            words = " ".join(row[i].strip() for i, _ in parts)
            time_us = round(1e6 * datetime.fromisoformat(words).timestamp())
        return time_us if abs(time_us) < LATEST_US else None
    except (ValueError, IndexError, OverflowError):
        return None


def _quaternion(numbers: Sequence[float]) -> Quaternion | None:
    if len(numbers) == 4:
        w, x, y, z = numbers
        return unit_or_none((w, x, y, z))
    return quaternion_from_euler(*numbers)
