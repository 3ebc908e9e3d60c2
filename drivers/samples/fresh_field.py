"""Which magnetic readings are new: autopilots repeat a slow magnetometer's in every IMU message."""

import math
from typing import Protocol

import numpy as np

from estimator.arrays import Bools, Floats, Times
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import types_of
from estimator.types import ZERO_VEC3, Vec3

REPEAT_US = 240_000  # autopilots repeat a 10 Hz field; equal values in a 4 Hz stream are data
STALE_US = 200_000  # an older field that was logged beside no longer belongs to the sample after it


class FreshField(Protocol):
    """What one IMU stream remembers of its fields."""

    def fresh(self, mag_gauss: Vec3, raw_us: int, time_us: int) -> Vec3 | None:
        """The field for an IMU sample; None if ``mag_gauss`` is zero or not new.

        ``raw_us`` is the sample's time as it came, ``time_us`` its place in time.
        """


class RepeatedField:
    """A field that every IMU message carries: fresh unless it repeats the last within 0.24 s."""

    def __init__(self) -> None:
        # the last fresh field (gauss) and its time (us); may be set to go on from there
        self.last: tuple[Vec3, int] = ZERO_VEC3, 0

    def fresh(self, mag_gauss: Vec3, _raw_us: int, time_us: int) -> Vec3 | None:
        """``mag_gauss``, or None if it is zero or repeated."""
        if not is_fresh(mag_gauss, time_us, *self.last):
            return None
        self.last = mag_gauss, time_us
        return mag_gauss

    def fresh_rows(self, mag_gauss: Floats, times_us: Times) -> Bools:
        """Which of N fields (N, 3) are: finite, not zero, and not repeated; (N,)."""
        fresh, last_gauss, last_us = fresh_of_rows(mag_gauss, times_us, *self.last)
        self.last = last_gauss, last_us
        return fresh


@inlined
def is_fresh(mag_gauss: Vec3, time_us: int, last: Vec3, last_us: int) -> bool:
    """Whether a field is neither zero nor a repetition of the last fresh one."""
    return mag_gauss != ZERO_VEC3 and not (mag_gauss == last and 0 <= time_us - last_us < REPEAT_US)


@compiled(types=lambda: types_of(np.zeros((1, 3)), np.zeros(1, np.int64), ZERO_VEC3, 0))
def fresh_of_rows(
    mag_gauss: Floats, times_us: Times, last: Vec3, last_us: int
) -> tuple[Bools, Vec3, int]:
    """What :meth:`RepeatedField.fresh` says of each row, and the last fresh field with its time."""
    fresh = np.zeros(len(times_us), np.bool_)
    for k in range(len(times_us)):
        field, time_us = (mag_gauss[k, 0], mag_gauss[k, 1], mag_gauss[k, 2]), times_us[k]
        finite = math.isfinite(field[0]) and math.isfinite(field[1]) and math.isfinite(field[2])
        if finite and is_fresh(field, time_us, last, last_us):
            fresh[k], last, last_us = True, field, time_us
    return fresh, last, last_us


class LoggedField:
    """A magnetometer that is logged beside the IMU, for all IMU streams of a vehicle.

    ``latest_gauss`` is its last reading, zero where that was no number.
    """

    def __init__(self) -> None:
        self.latest_gauss: Vec3 = ZERO_VEC3
        self.raw_us = 0
        self.number = 0  # of the latest reading that is data
        self._repetition = RepeatedField()

    def put(self, mag_gauss: Vec3, raw_us: int) -> None:
        """Take a reading in, with its time on the log's clock."""
        self.latest_gauss = finite_or_zero(mag_gauss)
        if self._repetition.fresh(self.latest_gauss, raw_us, raw_us) is not None:
            self.raw_us = raw_us
            self.number += 1

    def for_stream(self) -> FreshField:
        """What gives each reading once, to the first sample of a stream behind it."""
        return _FieldBeside(self)


class _FieldBeside:
    def __init__(self, logged: LoggedField) -> None:
        self._logged = logged
        self._given = 0

    def fresh(self, mag_gauss: Vec3, raw_us: int, _time_us: int) -> Vec3 | None:
        logged = self._logged
        is_new = self._given != logged.number and abs(raw_us - logged.raw_us) <= STALE_US
        if mag_gauss == ZERO_VEC3 or not is_new:
            return None
        self._given = logged.number
        return mag_gauss


def finite_or_zero(vector: Vec3) -> Vec3:
    """The vector, or zero, which stands for none, if a part of it is not finite."""
    x, y, z = vector
    return vector if math.isfinite(x) and math.isfinite(y) and math.isfinite(z) else ZERO_VEC3
