"""The attitudes of many vehicles at one tick, as rows of numbers.

Those who publish write them as they are. Others see a record a vehicle, which is made for the
first who asks.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

from drivers.events import VehicleId
from estimator.types import ImuSample
from service.attitude_text import (
    AGE_US,
    BOOT_US,
    NUMBERS,
    REFERENCE,
    SEQUENCE,
    STATE,
    UNIX_US,
    WHOLE,
    WORDS,
    texts_of,
    texts_of_records,
)
from service.records import (
    SCHEMA,
    AttitudeRecord,
    Confidence,
    Encoded,
    Output,
    Published,
    Sigma,
)

Array = Any  # numba ships no types

# Of whole numbers a row has those of the text, and its sample's time and whether there is a field.
SAMPLE_US, HAS_MAG, ROW_WHOLE = WHOLE, WHOLE + 1, WHOLE + 2
SHOWN_NUMBERS = NUMBERS + 9  # the reading is behind the others


class AttitudeRows:
    """Attitudes of ``vehicles``, with their numbers in the columns of :mod:`service.attitude_text`.

    Behind those stand the readings that they come from: rate, force and field.
    """

    def __init__(self, vehicles: Sequence[VehicleId], whole: Array, numbers: Array) -> None:
        self.vehicles = vehicles
        self._whole = whole
        self._numbers = numbers

    def __len__(self) -> int:
        return len(self.vehicles)

    @cached_property
    def texts(self) -> list[bytes]:
        """What is published of each vehicle."""
        return texts_of(self._whole, self._numbers)

    @cached_property
    def published(self) -> list[Published]:
        """The records, and the samples that they come from."""
        rows = (self._whole.tolist(), self._numbers.tolist())
        return [
            Published(vehicle, _record(whole, numbers), _sample(whole, numbers[NUMBERS:]))
            for vehicle, whole, numbers in zip(self.vehicles, *rows, strict=True)
        ]


Made = Output | AttitudeRows


def expanded(outputs: Iterable[Made]) -> list[Output]:
    """The outputs with a record for each row."""
    return [
        output
        for each in outputs
        for output in (each.published if isinstance(each, AttitudeRows) else (each,))
    ]


def encoded(outputs: Sequence[Made]) -> Sequence[Made]:
    """The outputs with the texts of attitudes in the place of their records."""
    records = [record for each in outputs if (record := attitude_of(each)) is not None]
    if not records:  # as nearly always
        return outputs
    texts = iter(texts_of_records(records))
    return [
        Encoded(each.vehicle, next(texts))
        if isinstance(each, Published) and attitude_of(each) is not None
        else each
        for each in outputs
    ]


def attitude_of(output: Made) -> AttitudeRecord | None:
    """The record of an output that is one vehicle's attitude."""
    record = output.record if isinstance(output, Published) else None
    return record if isinstance(record, AttitudeRecord) else None


def _record(whole: list[int], numbers: list[float]) -> AttitudeRecord:
    w, x, y, z, *vectors = numbers[:13]
    return AttitudeRecord(
        SCHEMA,
        whole[UNIX_US],
        whole[BOOT_US],
        (w, x, y, z),
        tuple(vectors[:3]),  # type: ignore[arg-type]
        tuple(vectors[3:6]),  # type: ignore[arg-type]
        tuple(vectors[6:]),  # type: ignore[arg-type]
        numbers[13],
        numbers[14],
        numbers[15],
        Confidence(numbers[16], numbers[17]),
        Sigma(numbers[18], numbers[19]),
        WORDS[whole[REFERENCE]],
        WORDS[whole[STATE]],
        whole[AGE_US] / 1e3,
        whole[SEQUENCE],
    )


def _sample(whole: list[int], reading: list[float]) -> ImuSample:
    return sample_of(whole[SAMPLE_US], reading, whole[HAS_MAG])


def sample_of(time_us: int, reading: list[float], has_mag: int) -> ImuSample:
    """The sample of a row."""
    gx, gy, gz, ax, ay, az, mx, my, mz = reading
    return ImuSample(time_us, (gx, gy, gz), (ax, ay, az), (mx, my, mz), has_mag == 1)
