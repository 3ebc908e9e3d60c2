"""An estimator that keeps what smoothing needs of its way through a recording."""

from array import array
from typing import Any

import numpy as np

from estimator.estimator import Estimator
from estimator.live.rows import Floats, Rows, cut
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.smoothing.recording import BIAS, SIGMA, Estimates, Q, Recording
from estimator.types import RateSample, Vec3, VelocitySample

# Of a sample taken alone: rate, specific force, field; of the attitude after it: q, bias, sigmas.
WIDTHS = (3, 3, 3, 4, 3, 2)


class Recorder(Estimator):
    """Ends a :class:`Recording` where the attitude is forgotten."""

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        super().__init__(profile, fixed_gain)
        self._ended: list[Recording] = []
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
        if reason is None:
            said = self.attitude(time_us)
            sigma = said.sigma_inclination_rad, said.sigma_heading_rad
            self._alone_us.append(time_us)
            told = (gyr_rad_s, acc_m_s2, mag_gauss, said[1], said[3], sigma)
            for column, values in zip(self._alone, told, strict=True):
                column.extend(values)
            self._has_mag.append(has_mag)
            self._is_aided.append(self.is_aided)
        return reason

    def update_rows(self, rows: Rows, said: Floats) -> int:
        """See :class:`Estimator`."""
        taken = super().update_rows(rows, said)
        if taken:
            self._stack()
            times_us, gyr, acc, mag, has_mag = cut(rows, 0, taken)
            told = (said[:taken, part] for part in (Q, BIAS, SIGMA))
            unaided = np.zeros(taken, np.bool_)
            self._chunks.append((times_us, gyr, acc, mag, *told, has_mag, unaided))
            self._taken += taken
        return taken

    def update_report(self, report: Any) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update_report(report)
        if reason is None and isinstance(report, VelocitySample | RateSample):
            self._reports.append(report)
        return reason

    def restart(self) -> None:
        """See :class:`Estimator`."""
        self._end()
        super().restart()

    def change_imu(self) -> None:
        """See :class:`Estimator`."""
        self._changes.append(self._taken + len(self._alone_us))
        super().change_imu()

    def _begin(self) -> None:
        self._chunks: list[tuple[Any, ...]] = []
        self._taken = 0  # in chunks
        self._reports: list[VelocitySample | RateSample] = []
        self._changes: list[int] = []
        self._begin_alone()

    def _begin_alone(self) -> None:
        self._alone_us, self._alone = array("q"), [array("d") for _ in WIDTHS]
        self._has_mag, self._is_aided = array("b"), array("b")

    def _stack(self) -> None:
        """Put what was taken sample by sample behind the chunks."""
        if self._alone_us:
            pairs = zip(self._alone, WIDTHS, strict=True)
            columns = (np.frombuffer(column).reshape(-1, width) for column, width in pairs)
            flags = (np.frombuffer(flag, np.bool_) for flag in (self._has_mag, self._is_aided))
            self._chunks.append((np.frombuffer(self._alone_us, np.int64), *columns, *flags))
            self._taken += len(self._alone_us)
            self._begin_alone()

    def _joined(self) -> tuple[Any, ...]:
        """The columns of all chunks, of a single one as they are."""
        if len(self._chunks) == 1:
            return self._chunks[0]
        return tuple(np.concatenate(column) for column in zip(*self._chunks, strict=True))

    def _end(self) -> None:
        """Make a recording of what there is since the last one."""
        self._stack()
        if self._chunks:
            times_us, gyr, acc, mag, q, bias, sigma, has_mag, aided = self._joined()
            last = Estimator(self.profile, self.fixed_gain)
            last.snapshot = self.snapshot
            rows, forward = Rows(times_us, gyr, acc, mag, has_mag), Estimates(q, sigma, aided)
            recording = Recording(rows, self._changes, self._reports, forward, bias, last)
            self._ended.append(recording)
        self._begin()
