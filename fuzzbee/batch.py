"""N samples on their way through an estimator, and the attitudes after them."""

from collections.abc import Sequence
from math import nan

import numpy as np
from numpy.typing import NDArray

from estimator.estimator import Estimator
from estimator.live.rows import HAS_HEADING, SAID
from estimator.types import Attitude, ImuSample
from fuzzbee.arguments import Floats, Times

__all__ = ["Batch", "Times"]

NORTHS = "<U8"  # "magnetic" is the longest of what a heading is measured from


class Batch:
    """Rows of readings in body axes as :mod:`estimator.live.rows` has them.

    ``said`` (N, :data:`SAID`) takes the attitudes, ``norths`` (N,) what their headings are measured
    from. Rows of ``velocity`` (N, 3) whose horizontal part is not known are no reports.
    """

    def __init__(self, times_us: Times, readings: Floats, velocity: Floats) -> None:
        self.times_us = times_us
        self.readings = readings
        self.velocity = velocity
        self.said: Floats = np.empty((len(times_us), SAID))
        self.norths: NDArray[np.str_] = np.full(len(times_us), "none", NORTHS)

    def __len__(self) -> int:
        return len(self.times_us)

    def reports(self) -> Sequence[int]:
        """The rows before which there is a velocity."""
        known = np.isfinite(self.velocity)
        rows: list[int] = np.flatnonzero(known[:, 0] & known[:, 1]).tolist()
        return rows

    def sample(self, k: int) -> ImuSample:
        """A row as one call takes it."""
        gx, gy, gz, ax, ay, az, mx, my, mz, has_mag = self.readings[k].tolist()
        time_us = int(self.times_us[k])
        return ImuSample(time_us, (gx, gy, gz), (ax, ay, az), (mx, my, mz), bool(has_mag))

    def take_run(self, inner: Estimator, begin: int, end: int) -> int:
        """Have the estimator take rows; the first of them that it has left to one call."""
        said = self.said[begin:end]
        taken = inner.update_rows(self.times_us[begin:end], self.readings[begin:end], said)
        norths = self.norths[begin : begin + taken]
        norths[:], without = inner.norths
        norths[said[:taken, HAS_HEADING] == 0.0] = without
        return begin + taken

    def is_finite(self, k: int) -> bool:
        """Whether the attitude after a row is one."""
        return bool(np.isfinite(self.said[k, :4]).all())

    def put(self, k: int, attitude: Attitude | None) -> None:
        """The attitude after a row that was taken by one call; NaN if there is none."""
        if attitude is None:
            self.said[k] = nan
            self.norths[k] = "none"
            return
        q, rate, bias = attitude[1:4]
        self.said[k] = (*q, *rate, *bias, *attitude[4:11], nan)
        self.norths[k] = attitude.heading_reference
