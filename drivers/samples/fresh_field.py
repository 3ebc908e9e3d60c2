"""Which magnetic readings are new: autopilots repeat a slow magnetometer's in every IMU message."""

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from estimator.types import ZERO_VEC3, Vec3

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
Flags = NDArray[np.bool_]

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
        self._last: Vec3 = ZERO_VEC3
        self._last_us = 0

    def fresh(self, mag_gauss: Vec3, _raw_us: int, time_us: int) -> Vec3 | None:
        """``mag_gauss``, or None if it is zero or repeated."""
        if mag_gauss == ZERO_VEC3:
            return None
        if mag_gauss == self._last and 0 <= time_us - self._last_us < REPEAT_US:
            return None
        self._last, self._last_us = mag_gauss, time_us
        return mag_gauss

    def fresh_rows(self, mag_gauss: Floats, times_us: Times) -> Flags:
        """Which of N fields (N, 3) are: finite, not zero, and not repeated; (N,)."""
        finite, other = np.isfinite(mag_gauss), mag_gauss != 0.0
        fresh = finite[:, 0] & finite[:, 1] & finite[:, 2]
        fresh &= other[:, 0] | other[:, 1] | other[:, 2]
        rows = np.flatnonzero(fresh)
        if not rows.size:
            return fresh
        # each field beside the one before, the last of earlier ones first
        fields = np.vstack([self._last, mag_gauss[rows]])
        changed = fields[1:] != fields[:-1]
        is_new = changed[:, 0] | changed[:, 1] | changed[:, 2]
        known_us = np.concatenate([[self._last_us], times_us[rows]])
        since = np.maximum.accumulate(np.where(is_new, np.arange(1, rows.size + 1), 0))
        age_us = known_us[1:] - known_us[since]
        if ((age_us < 0) | (age_us >= REPEAT_US)).any():  # a repetition may count as new
            for k in rows.tolist():
                x, y, z = mag_gauss[k].tolist()
                fresh[k] = self.fresh((x, y, z), 0, int(times_us[k])) is not None
            return fresh
        x, y, z = fields[-1].tolist()
        self._last, self._last_us = (x, y, z), int(known_us[since[-1]])
        fresh[rows] = is_new
        return fresh


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
