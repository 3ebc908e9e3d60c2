"""An estimator that keeps what smoothing needs of its way through a recording."""

from array import array
from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.live.rows import (
    AIDED,
    BIAS,
    NO_REPORT_ROWS,
    REPORT_SIZE,
    SIGMA,
    Q,
    Rows,
    report_rows_of,
)
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.smoothing.recording import Estimates, Recording
from estimator.types import RateSample, Vec3, VelocitySample

# Of a sample: rate, specific force, field; of the attitude after it: q, bias, sigmas.
WIDTHS = (3, 3, 3, 4, 3, 2)


class Offered(NamedTuple):
    """Arrays with all samples that will come, and with the output for each."""

    rows: Rows
    output: Floats  # (N, OUTPUT_SIZE), see :mod:`estimator.live.rows`


class Recorder(Estimator):
    """Ends a :class:`Recording` where the attitude is forgotten.

    With ``offered`` its recordings are views of those arrays, and smoothing changes them.
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
        if reason is None:
            self._is_aided.append(self.is_aided)
            if self._offered is None:
                output = self.attitude(time_us)
                sigma = output.sigma_inclination_rad, output.sigma_heading_rad
                kept = (gyr_rad_s, acc_m_s2, mag_gauss, output[1], output[3], sigma)
                for column, values in zip(self._kept, kept, strict=True):
                    column.extend(values)
                self._times_us.append(time_us)
                self._has_mag.append(has_mag)
        return reason

    def update_rows(
        self,
        rows: Rows,
        output: Floats,
        reports: Floats = NO_REPORT_ROWS,
        taken: int = 0,
        next_report: int = 0,
    ) -> tuple[int, int]:
        """See :class:`Estimator`."""
        begin, first = taken, next_report
        taken, next_report = super().update_rows(rows, output, reports, taken, next_report)
        self._reports.frombytes(reports[first:next_report].tobytes())
        part = slice(begin, taken)
        self._is_taken.frombytes(b"\1" * (taken - begin))
        self._is_aided.frombytes((output[part, AIDED] > 0.0).tobytes())
        if self._offered is None:
            times_us, *readings, has_mag = (column[part] for column in rows)
            kept = (*readings, *(output[part, columns] for columns in (Q, BIAS, SIGMA)))
            for column, values in zip(self._kept, kept, strict=True):
                column.frombytes(values.tobytes())
            self._times_us.frombytes(times_us.tobytes())
            self._has_mag.frombytes(has_mag.tobytes())
        return taken, next_report

    def update_report(self, report: Any) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update_report(report)
        if reason is None and isinstance(report, VelocitySample | RateSample):
            self._reports.frombytes(report_rows_of([(0, report)]).tobytes())
        return reason

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self._end()
        super().restart()

    def change_imu(self) -> None:
        """See :class:`Estimator`."""
        self._changes.append(len(self._is_aided))
        super().change_imu()

    def _begin(self) -> None:
        self._is_taken, self._is_aided = array("b"), array("b")
        self._times_us, self._kept = array("q"), [array("d") for _ in WIDTHS]
        self._has_mag = array("b")
        self._reports = array("d")
        self._changes: list[int] = []

    def _end(self) -> None:
        """Make a recording of what there is since the last one."""
        if self._is_aided:
            rows, (q, bias, sigma), places = self._taken()
            forward = Estimates(q, sigma, np.frombuffer(self._is_aided, np.bool_))
            reports = np.frombuffer(self._reports).reshape(-1, REPORT_SIZE)
            last = Estimator(self.profile, self.fixed_gain)
            last.snapshot = self.snapshot
            recording = Recording(rows, self._changes, reports, forward, bias, last, places)
            self._ended.append(recording)
        self._before += len(self._is_taken)
        self._begin()

    def _taken(self) -> tuple[Rows, tuple[Floats, ...], Any]:
        """The readings; q, bias and sigmas; where they stand in the arrays, if there are some."""
        offered = self._offered
        if offered is None:
            pairs = zip(self._kept, WIDTHS, strict=True)
            gyr, acc, mag, *output = (np.frombuffer(c).reshape(-1, width) for c, width in pairs)
            has_mag = np.frombuffer(self._has_mag, np.bool_)
            times_us = np.frombuffer(self._times_us, np.int64)
            return Rows(times_us, gyr, acc, mag, has_mag), tuple(output), slice(None)
        is_taken = np.frombuffer(self._is_taken, np.bool_)
        places: Any = slice(self._before, self._before + len(is_taken))
        if not is_taken.all():
            places = self._before + np.flatnonzero(is_taken)
        output = offered.output[places]
        rows = Rows(*(column[places] for column in offered.rows))
        return rows, tuple(output[:, part] for part in (Q, BIAS, SIGMA)), places
