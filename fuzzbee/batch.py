"""N samples on their way through an estimator, and the attitudes after them."""

from collections.abc import Sequence
from math import isfinite, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.live.rows import HAS_HEADING, SAID, Rows, cut
from estimator.types import ZERO_VEC3, Attitude, ImuSample
from fuzzbee.column_store import NORTHS, PLACE


class Batch:
    """Rows of readings as :mod:`estimator.live.rows` has them.

    ``said`` (N, :data:`SAID`) takes the attitudes. Rows of ``velocity`` (N, 3) whose horizontal
    part is not known are no reports, and there are none without it.
    """

    def __init__(self, rows: Rows, velocity: Floats | None) -> None:
        self.rows = rows
        self.velocity = velocity
        self.said: Floats = np.empty((len(self), SAID))
        self._norths: NDArray[np.uint8] = np.zeros(len(self), np.uint8)

    def __len__(self) -> int:
        return len(self.rows.times_us)

    @property
    def norths(self) -> NDArray[np.str_]:
        """What the heading of each row is measured from (N,)."""
        return np.array(NORTHS).take(self._norths)

    def tell_last_north(self, rows: Any) -> None:
        """What the heading of the last row is measured from holds for these rows as well."""
        self._norths[rows] = self._norths[-1]

    def reports(self) -> Sequence[int]:
        """The rows before which there is a velocity."""
        if self.velocity is None:
            return ()
        known = np.isfinite(self.velocity)
        rows: list[int] = np.flatnonzero(known[:, 0] & known[:, 1]).tolist()
        return rows

    def sample(self, k: int) -> ImuSample:
        """A row as one call takes it."""
        rows = self.rows
        gx, gy, gz = rows.gyr_rad_s[k].tolist()
        ax, ay, az = rows.acc_m_s2[k].tolist()
        time_us, mag = int(rows.times_us[k]), ZERO_VEC3
        has_mag = bool(rows.has_mag[k])
        if has_mag:
            mx, my, mz = rows.mag_gauss[k].tolist()
            mag = (mx, my, mz)
        return ImuSample(time_us, (gx, gy, gz), (ax, ay, az), mag, has_mag)

    def take_run(self, inner: Estimator, begin: int, end: int) -> int:
        """Have the estimator take rows; the first of them that it has left to one call."""
        said = self.said[begin:end]
        taken = inner.update_rows(cut(self.rows, begin, end), said)
        north, without = inner.norths
        norths = self._norths[begin : begin + taken]
        norths[:] = PLACE[north]
        norths[said[:taken, HAS_HEADING] == 0.0] = PLACE[without]
        return begin + taken

    def is_finite(self, k: int) -> bool:
        """Whether the attitude after a row is one."""
        w, x, y, z = self.said[k, :4].tolist()
        return isfinite(w + x + y + z)

    def put(self, k: int, attitude: Attitude | None) -> None:
        """The attitude after a row that was taken by one call; NaN if there is none."""
        if attitude is None:
            self.said[k] = nan
            self._norths[k] = PLACE["none"]
            return
        q, rate, bias = attitude[1:4]
        self.said[k] = (*q, *rate, *bias, *attitude[4:11], nan)
        self._norths[k] = PLACE[attitude.heading_reference]
