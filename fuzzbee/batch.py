"""N samples on their way through an estimator, and the attitudes after them."""

from collections.abc import Sequence
from math import nan
from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.live.rows import HAS_HEADING, Rows, cut
from estimator.types import Attitude
from fuzzbee.attitudes import NORTHS, PLACE, Attitudes, attitudes_of_rows


class Batch(NamedTuple):
    """Rows of readings as :mod:`estimator.live.rows` has them, and warnings about them.

    ``said`` (N, :data:`SAID`) takes the attitudes; its last column takes the place in ``NORTHS`` of
    what a heading is measured from. Rows of ``velocity`` (N, 3) whose horizontal part is not known
    are no reports, and there are none without it.
    """

    rows: Rows
    velocity: Floats | None
    said: Floats
    warnings: tuple[str, ...]

    @property
    def attitudes(self) -> Attitudes:
        """What is said."""
        norths = np.array(NORTHS).take(self.said[:, HAS_HEADING].astype(np.uint8))
        return attitudes_of_rows(self.rows.times_us, self.said, norths, self.warnings)

    def reports(self) -> Sequence[int]:
        """The rows before which there is a velocity."""
        if self.velocity is None:
            return ()
        rows: list[int] = np.flatnonzero(np.isfinite(self.velocity[:, :2]).all(axis=1)).tolist()
        return rows

    def sample(self, k: int) -> Any:
        """A row as one call takes it; a field counts only where it is marked as one."""
        time_us, gyr, acc, mag, has_mag = (column[k].tolist() for column in self.rows)
        return time_us, tuple(gyr), tuple(acc), tuple(mag) if has_mag else (0.0,) * 3, has_mag

    def take_run(self, inner: Estimator, begin: int, end: int) -> int:
        """Have the estimator take rows; the first of them that it has left to one call."""
        said = self.said[begin:end]
        taken = inner.update_rows(cut(self.rows, begin, end), said)
        north, without = inner.norths
        has_heading = said[:taken, HAS_HEADING] != 0.0
        said[:taken, HAS_HEADING] = np.where(has_heading, PLACE[north], PLACE[without])
        return begin + taken

    def put(self, k: int, attitude: Attitude | None) -> None:
        """The attitude after a row that was taken by one call; NaN if there is none."""
        if attitude is None:
            self.said[k] = nan
            self.said[k, HAS_HEADING] = PLACE["none"]
            return
        q, rate, bias = attitude[1:4]
        self.said[k] = (*q, *rate, *bias, *attitude[4:11], PLACE[attitude.heading_reference])
