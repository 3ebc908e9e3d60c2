"""Tables of IMU readings as text (.csv): one row a sample, as other programs write them."""

from collections.abc import Iterator, Sequence
from datetime import datetime
from math import isnan, nan
from pathlib import Path
from typing import Any, Literal

from drivers.events import COMPASS_CALIBRATED, Event, Parameter
from drivers.logs.csv_columns import Part, columns, description
from drivers.logs.csv_text import HEAD_SIZE, CsvText, as_number, csv_rows, csv_text
from drivers.logs.log_file import LATEST_US, LogFile
from drivers.logs.logged_vehicle import LoggedVehicle
from drivers.samples.navigation import Fix
from estimator.errors import InputError

STREAM = "CSV"
ATTITUDES: tuple[tuple[str, Literal["sim", "autopilot"]], ...] = (
    ("truth", "sim"),
    ("autopilot", "autopilot"),
)
RECEIVER = "GPS"
NO_NUMBERS = (nan, nan, nan)


class CsvLog(LogFile):
    """A table as events; each iteration reads the file from its start, a row at a time.

    Raises:
        InputError: it is not clear what the columns are, or the description is wrong.
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
        vehicle, about = None, self._columns
        for row in csv_rows(self.path, self._text, self.on_read):
            time_us = _time_us(self._text, row, about.time)
            if vehicle is None:
                vehicle = LoggedVehicle(begin_us=time_us or 0, checks_axes=about.checks_axes)
                if (flag := about.compass_calibrated) is not None:
                    yield Parameter(vehicle.id, vehicle.arrival_us, COMPASS_CALIBRATED, flag)
            if time_us is None:
                yield vehicle.malformed()
            else:
                vehicle.at(time_us)
                yield from self._events(vehicle, row)
        if vehicle is not None:
            yield from vehicle.intake.end()

    def _events(self, vehicle: LoggedVehicle, row: Sequence[str]) -> Iterator[Event]:
        """The events of a row; what is empty is not there, a row with no number for one counted."""
        read, is_whole, comma = dict[str, Any](), True, self._text.has_decimal_comma
        for name, parts in self._columns.parts.items():
            try:
                numbers = [factor * as_number(row[i], comma) for i, factor in parts]
            except (ValueError, IndexError):
                is_whole = False
                continue
            if not any(map(isnan, numbers)):
                read[name] = numbers
        velocity, place = read.get("velocity"), read.get("position")
        if velocity is not None or place is not None:
            at = None if place is None else (*place, 0.0)[:3]  # it may have no altitude
            yield from vehicle.fix(RECEIVER, Fix(velocity, position=at))
        if "magnetometer" in read:
            vehicle.put_mag(read["magnetometer"])
        gyr, acc = read.get("gyroscope"), read.get("accelerometer")
        if (gyr and acc) or (is_whole and (gyr or acc)):  # half an IMU is refused, and counted
            yield from vehicle.imu(STREAM, gyr or NO_NUMBERS, acc or NO_NUMBERS)
        for name, source in ATTITUDES:
            if name in read:
                is_enu_flu = name in self._columns.enu_flu
                yield from vehicle.attitude(name, source, read[name], is_enu_flu=is_enu_flu)
        if not is_whole:
            yield vehicle.malformed()


def _time_us(text: CsvText, row: Sequence[str], parts: Sequence[Part]) -> int | None:
    """The row's time; None if it has none that can be."""
    index, factor = parts[0]
    try:
        if factor:
            time_us = round(factor * as_number(row[index], text.has_decimal_comma))
        else:
            words = " ".join(row[i].strip() for i, _ in parts)
            time_us = round(1e6 * datetime.fromisoformat(words).timestamp())
        return time_us if abs(time_us) < LATEST_US else None
    except (ValueError, IndexError, OverflowError):
        return None
