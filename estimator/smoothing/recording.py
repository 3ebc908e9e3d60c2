"""What smoothing takes: the readings, and the output of an estimator on its way through them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import Bools, Floats
from estimator.conditioning.params import MEMORY_S
from estimator.estimator import Estimator
from estimator.geometry.rotations import conjugate, exp, log, multiply
from estimator.live.rows import NO_REPORT_ROWS, Rows, blocks, cut

Places = NDArray[np.int64]


class Estimates(NamedTuple):
    """N attitudes in time; NaN where there is none."""

    q_ned_frd: Floats  # (N, 4)
    sigma_rad: Floats  # (N, 2) of inclination and heading
    is_aided: Bools  # (N,) whether velocity helped

    def part(self, rows: slice) -> "Estimates":
        """Some of them."""
        return Estimates._make(column[rows] for column in self)


class Recording(NamedTuple):
    """Readings without a restart between them, as they were taken."""

    rows: Rows
    changes: Sequence[int]  # the rows from which on they are another IMU's
    reports: Floats  # (M, REPORT_SIZE) by others, in the order in which it came
    forward: Estimates  # of the estimator at the samples
    bias_rad_s: Floats  # (N, 3) of the gyroscope, as it was known then
    last: Estimator  # the estimator behind the last one
    places: Any = slice(None)  # of the rows among those that were offered

    @property
    def rate_rad_s(self) -> Floats:
        """The gyroscope's rates (N, 3) less the bias."""
        return np.asarray(self.rows.gyr_rad_s - self.bias_rad_s)

    def last_rows(self, rows: Places) -> Places:
        """The last row of the same IMU, for each of these rows."""
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
            reports=NO_REPORT_ROWS,
            forward=self.forward.part(rows),
            bias_rad_s=self.bias_rad_s[rows],
        )


def steps_s(rows: Rows) -> Floats:
    """Intervals (N,) before each row; the first one is 0."""
    return 1e-6 * np.diff(rows.times_us, prepend=rows.times_us[:1]).astype(np.float64)


def join(forward: Estimates, backward: Estimates) -> Estimates:
    """The joint estimates, in the room of the backward ones."""
    for rows in blocks(len(backward.is_aided)):
        joint = joined(forward.part(rows), backward.part(rows))
        for now, before in zip(joint, backward, strict=True):
            before[rows] = now
    return backward


def joined(forward: Estimates, backward: Estimates) -> Estimates:
    """The mean by both variances, of inclination and heading apart.

    With velocity each has learnt what the other has not, so sigma is that of independent errors;
    without it both err by the same field, so it is the mean of both. It grows if they are further
    apart than their sigmas allow (R. T. Birge 1932, Phys. Rev. 40, 207). If velocity helps only one
    of them, or one is not known, the other does not count.
    """
    one, other = forward.sigma_rad, backward.sigma_rad
    apart = log(multiply(backward.q_ned_frd, conjugate(forward.q_ned_frd)))
    between = np.stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])], axis=-1)
    expected = np.hypot(one, other)
    share = (one / expected) ** 2
    least = np.where(forward.is_aided[:, None], 1.0, (one + other) / expected)
    sigma = one * other / expected * np.maximum(least, between / expected)
    turn = apart * share[:, [0, 0, 1]]
    both = Estimates(multiply(exp(turn), forward.q_ned_frd), sigma, forward.is_aided)
    both = chosen(forward.is_aided & ~backward.is_aided, forward, both)
    both = chosen(backward.is_aided & ~forward.is_aided, backward, both)
    for each in (forward, backward):
        both = chosen(known_rows(both), both, each)
    return both


def known_rows(estimates: Estimates) -> Bools:
    """Whether there is an attitude with its sigmas (N,)."""
    numbers = (estimates.q_ned_frd, estimates.sigma_rad)
    return np.asarray(np.all([np.isfinite(each).all(axis=1) for each in numbers], axis=0))


def chosen(rows: Bools, first: Estimates, second: Estimates) -> Estimates:
    """The first where ``rows`` (N,) are true, else the second."""
    if not rows.any():
        return second
    if rows.all():
        return first
    return Estimates(
        np.where(rows[:, None], first.q_ned_frd, second.q_ned_frd),
        np.where(rows[:, None], first.sigma_rad, second.sigma_rad),
        np.where(rows, first.is_aided, second.is_aided),
    )
