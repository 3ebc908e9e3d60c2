"""Tables of IMU readings as text (.csv): one row a sample, as other programs write them."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from math import isnan
from pathlib import Path
from typing import Literal

from drivers.events import COMPASS_CALIBRATED, Event, Parameter
from drivers.logs.csv_columns import Part, columns, description
from drivers.logs.csv_text import CsvText, csv_rows, csv_text
from drivers.logs.log_file import LATEST_US, LogFile
from drivers.logs.logged_vehicle import LoggedVehicle, dated_vehicle
from drivers.samples.navigation import Fix, quaternion_from_euler, unit_or_none
from estimator.errors import InputError
from estimator.geometry.frames import ned_frd_from_enu_flu
from estimator.types import Quaternion, Vec3

STREAM = "CSV"
ATTITUDES: tuple[tuple[str, Literal["sim", "autopilot"]], ...] = (
    ("truth", "sim"),
    ("autopilot", "autopilot"),
)
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
        layout = description(path, described)
        try:
            self._columns = columns(text, layout)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def __iter__(self) -> Iterator[Event]:
        """The events; times count from the first row, also backwards: clocks are set."""
        vehicle = None
        with csv_rows(self.path, self._text, self.on_read) as rows:
            for row in rows:
                time_us = None if row is None else _time_us(self._text, row, self._columns.time)
                if vehicle is None:
                    vehicle = dated_vehicle(time_us or 0, checks_axes=self._columns.checks_axes)
                    if (word := self._columns.compass_calibrated) is not None:
                        about = vehicle.id, vehicle.arrival_us
                        yield Parameter(*about, COMPASS_CALIBRATED, word)
                if row is None or time_us is None:
                    yield vehicle.malformed()
                else:
                    vehicle.at(time_us)
                    yield from self._events(vehicle, row)
            if vehicle is not None:
                yield from vehicle.end()

    def _events(self, vehicle: LoggedVehicle, row: Sequence[str]) -> Iterator[Event]:
        """The events of a row; what is empty is not there, a row with no number for one counted."""
        read, is_whole = dict[str, list[float]](), True
        for name, parts in self._columns.parts.items():
            try:
                numbers = [factor * self._text.number(row[i]) for i, factor in parts]
            except (ValueError, IndexError):
                is_whole = False
                continue
            if not any(map(isnan, numbers)):
                read[name] = numbers
        velocity, place = _vector(read.get("velocity")), _vector(read.get("position"))
        if velocity is not None or place is not None:
            yield from vehicle.fix(RECEIVER, Fix(velocity, position=place))
        if (mag := _vector(read.get("magnetometer"))) is not None:
            vehicle.put_mag(mag)
        gyr, acc = _vector(read.get("gyroscope")), _vector(read.get("accelerometer"))
        if gyr is not None and acc is not None:
            yield from vehicle.imu(STREAM, gyr, acc)
        for name, source in ATTITUDES:
            if name in read:
                q = _quaternion(read[name])
                if q is not None and name in self._columns.enu_flu:
                    q = ned_frd_from_enu_flu(q)
                yield from vehicle.attitude(name, source, q)
        if not is_whole:
            yield vehicle.malformed()


def _vector(numbers: list[float] | None) -> Vec3 | None:
    """Three numbers; a place may have no altitude."""
    if numbers is None:
        return None
    x, y, z = [*numbers, 0.0][:3]
    return x, y, z


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
