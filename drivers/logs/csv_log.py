"""Tables of IMU readings as text (.csv): one row a sample, as other programs write them."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from itertools import chain, islice
from math import isnan, nan
from pathlib import Path
from typing import Any

from drivers.events import COMPASS_CALIBRATED, Event, Parameter
from drivers.logs.csv_columns import columns, description
from drivers.logs.csv_text import HEAD_SIZE, as_number, csv_rows, csv_text
from drivers.logs.log_file import LATEST_US, LogFile
from drivers.logs.logged_vehicle import RECEIVER, UNREADABLE, LoggedVehicle
from drivers.samples.navigation import Fix, Source
from estimator.errors import InputError

STREAM = "CSV"
ATTITUDES: dict[str, Source] = {"truth": "sim", "autopilot": "autopilot"}
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
        self._is_calibrated = layout.compass_calibrated
        try:
            self._columns = columns(text, layout)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def __iter__(self) -> Iterator[Event]:
        """The events; times count from the first row, also backwards: clocks are set."""
        rows, about, begin_us = csv_rows(self.path, self._text, self.on_read), self._columns, 0
        for first in islice(rows, 1):
            with suppress(*UNREADABLE):
                begin_us = self._time_us(first)
            vehicle = LoggedVehicle(begin_us=begin_us, checks_axes=about.checks_axes)
            if (flag := self._is_calibrated) is not None:
                yield Parameter(vehicle.id, vehicle.arrival_us, COMPASS_CALIBRATED, flag)
            yield from vehicle.events(chain([first], rows), self._events)

    def _events(self, vehicle: LoggedVehicle, row: Sequence[str]) -> Iterator[Event]:
        """The events of a row; what is empty is not there, a row with no number for one counted."""
        vehicle.at(self._time_us(row))
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
        for name, source in ATTITUDES.items():
            if name in read:
                is_enu_flu = name in self._columns.enu_flu
                yield from vehicle.attitude(name, source, read[name], is_enu_flu=is_enu_flu)
        if not is_whole:
            yield vehicle.malformed()

    def _time_us(self, row: Sequence[str]) -> int:
        """The row's time.

        Raises:
            LookupError, ValueError, OverflowError: it has none that can be.
        """
        index, factor = self._columns.time[0]
        if factor:
            time_us = round(factor * as_number(row[index], self._text.has_decimal_comma))
        else:
            words = " ".join(row[i].strip() for i, _ in self._columns.time)
            time_us = round(1e6 * datetime.fromisoformat(words).timestamp())
        if abs(time_us) >= LATEST_US:
            raise ValueError(time_us)
        return time_us
