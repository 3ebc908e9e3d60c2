"""An estimator that keeps what smoothing needs of its way through a recording."""

from array import array
from typing import Any, NamedTuple

import numpy as np

from estimator.estimator import Estimator
from estimator.live.published import write
from estimator.live.rows import (
    NO_REPORT_ROWS,
    OUTPUT_SIZE,
    REPORT_SIZE,
    Rows,
    report_row_of,
)
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.smoothing.recording import Recording
from estimator.types import Bools, Floats, RateSample, Vec3, VelocitySample

# Columns of a sample that it keeps itself: rate, specific force, field, whether there is one.
READING_SIZE = 10


class Offered(NamedTuple):
    """Arrays with all samples that will come, and with the output for each."""

    rows: Rows
    output: Floats  # (N, OUTPUT_SIZE), see :mod:`estimator.live.rows`


class Recorder(Estimator):
    """Ends a :class:`Recording` where the attitude is forgotten.

    With ``offered`` its recordings are views of those arrays, and smoothing changes them. Otherwise
    it keeps copies of what it takes.
    """

    def __init__(
        self, profile: Profile, fixed_gain: float | None = None, offered: Offered | None = None
    ) -> None:
        super().__init__(profile, fixed_gain)
        self._ended: list[Recording] = []
        self._offered = offered
        self._before = 0  # how many have been offered before this recording
        self._begin()

    def recordings(self) -> list[Recording]:
        """All until now; the last one ends here."""
        self._end()
        return self._ended

    def take(
        self, time_us: int, gyr_rad_s: Vec3, acc_m_s2: Vec3, mag_gauss: Vec3, has_mag: bool
    ) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().take(time_us, gyr_rad_s, acc_m_s2, mag_gauss, has_mag)
        self._is_taken.append(reason is None)
        if reason is None and self._offered is None:
            self._times_us.append(time_us)
            self._readings.extend((*gyr_rad_s, *acc_m_s2, *mag_gauss, has_mag))
            row = np.empty(OUTPUT_SIZE)
            write(row, self.published_at(time_us), self.is_aided)
            self._output.frombytes(row.tobytes())
        return reason

    def update_rows(
        self,
        rows: Rows,
        published: Floats,
        report_rows: Floats = NO_REPORT_ROWS,
        taken: int = 0,
        next_report: int = 0,
    ) -> tuple[int, int]:
        """See :class:`Estimator`."""
        begin, first = taken, next_report
        taken, next_report = super().update_rows(rows, published, report_rows, taken, next_report)
        self._reports.frombytes(report_rows[first:next_report].tobytes())
        self._is_taken.frombytes(b"\1" * (taken - begin))
        if self._offered is None:
            times_us, *readings = (column[begin:taken] for column in rows)
            self._times_us.frombytes(times_us.tobytes())
            self._readings.frombytes(np.column_stack(readings).tobytes())
            self._output.frombytes(published[begin:taken].tobytes())
        return taken, next_report

    def update_report(self, report: Any) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update_report(report)
        if reason is None and isinstance(report, VelocitySample | RateSample):
            self._reports.frombytes(report_row_of(0, report).tobytes())
        return reason

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self._end()
        super().restart()

    def change_imu(self) -> None:
        """See :class:`Estimator`."""
        self._changes.append(self._is_taken.count(1))
        super().change_imu()

    def _begin(self) -> None:
        self._is_taken, self._times_us = array("b"), array("q")
        self._readings, self._output, self._reports = array("d"), array("d"), array("d")
        self._changes: list[int] = []

    def _end(self) -> None:
        """Make a recording of what there is since the last one."""
        is_taken = np.frombuffer(self._is_taken, np.bool_)
        if is_taken.any():
            places: Any = slice(None)
            if self._offered is None:
                rows, output = self._kept()
            else:
                places = places_of(is_taken, self._before)
                rows = Rows._make(column[places] for column in self._offered.rows)
                output = self._offered.output[places]
            reports = np.frombuffer(self._reports).reshape(-1, REPORT_SIZE)
            last = Estimator(self.profile, self.fixed_gain)
            last.snapshot = self.snapshot
            recording = Recording(rows, output, self._changes, reports, last, places)
            self._ended.append(recording)
        self._before += len(is_taken)
        self._begin()

    def _kept(self) -> tuple[Rows, Floats]:
        """The copies of readings and output."""
        readings = np.frombuffer(self._readings).reshape(-1, READING_SIZE)
        gyr, acc, mag, has_mag = np.split(readings, (3, 6, 9), axis=1)
        times_us = np.frombuffer(self._times_us, np.int64)
        rows = Rows(times_us, gyr, acc, mag, has_mag[:, 0] > 0.0)
        return rows, np.frombuffer(self._output).reshape(-1, OUTPUT_SIZE)


def places_of(is_taken: Bools, before: int) -> Any:
    """Where the samples stand that were taken behind so many others: a slice if all were."""
    if is_taken.all():
        return slice(before, before + len(is_taken))
    return before + np.flatnonzero(is_taken)
