"""What smoothing takes: the readings, and what an estimator has said on its way through them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import Bools, Floats
from estimator.conditioning.times import MEMORY_S
from estimator.estimator import Estimator
from estimator.live.rows import NOTHING_TOLD, Rows, blocks, cut

Places = NDArray[np.int64]


class Estimates(NamedTuple):
    """N attitudes in time; NaN where there is none."""

    q_ned_frd: Floats  # (N, 4)
    sigma_rad: Floats  # (N, 2) of inclination and heading
    is_aided: Bools  # (N,) whether velocity helped

    def part(self, rows: slice) -> "Estimates":
        """Some of them."""
        return Estimates(self.q_ned_frd[rows], self.sigma_rad[rows], self.is_aided[rows])


class Recording(NamedTuple):
    """Readings without a restart between them, as they were taken."""

    rows: Rows
    changes: Sequence[int]  # the rows from which on they are another IMU's
    told: Floats  # (M, TOLD) by others, in the order in which it came
    forward: Estimates  # of the estimator at the samples
    bias_rad_s: Floats  # (N, 3) of the gyroscope, as it was known then
    last: Estimator  # the estimator behind the last one
    places: Any = slice(None)  # of the rows among those that were offered

    @property
    def rate_rad_s(self) -> Floats:
        """The gyroscope's rates (N, 3) less the bias."""
        return np.asarray(self.rows.gyr_rad_s - self.bias_rad_s)

    def last_rows(self, rows: Places) -> Places:
        """Of each of these rows, the last one of the same IMU."""
        ends = np.array([*self.changes, len(self.rows.times_us)])
        return np.asarray(ends[np.searchsorted(ends, rows, side="right")] - 1)

    def look_ahead(self) -> None:
        """Let the bias be what is known of it later."""
        times_us = self.rows.times_us
        for part in blocks(len(times_us)):
            until_us = times_us[part] + round(1e6 * MEMORY_S)
            later = np.searchsorted(times_us, until_us, side="right") - 1
            last = self.last_rows(np.arange(part.start, part.stop))
            self.bias_rad_s[part] = self.bias_rad_s[np.minimum(later, last)]

    def part(self, begin: int, end: int) -> "Recording":
        """Rows from ``begin`` up to ``end``, of one IMU and without reports."""
        rows = slice(begin, end)
        return self._replace(
            rows=cut(self.rows, begin, end),
            changes=(),
            told=NOTHING_TOLD,
            forward=self.forward.part(rows),
            bias_rad_s=self.bias_rad_s[rows],
        )


def steps_s(rows: Rows) -> Floats:
    """Intervals (N,) before each row; the first one is 0."""
    return 1e-6 * np.diff(rows.times_us, prepend=rows.times_us[:1]).astype(np.float64)
