"""What smoothing takes: the readings, and the output of an estimator on its way through them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from estimator.conditioning.params import MEMORY_S
from estimator.estimator import Estimator
from estimator.geometry.rotations import conjugate, exp, log, multiply
from estimator.live.rows import AIDED, BIAS, NO_REPORT_ROWS, SIGMA, Q, Rows, blocks, cut
from estimator.types import Bools, Floats, Ints


class Estimates(NamedTuple):
    """N attitudes in time; NaN where there is none."""

    q_ned_frd: Floats  # (N, 4)
    sigma_rad: Floats  # (N, 2) of inclination and heading
    is_aided: Bools  # (N,) whether velocity helped

    def part(self, rows: slice) -> "Estimates":
        """Some of them."""
        return Estimates._make(column[rows] for column in self)


def estimates_of(output: Floats) -> Estimates:
    """Those in rows of an estimator's output (N, OUTPUT_SIZE)."""
    return Estimates(output[:, Q], output[:, SIGMA], output[:, AIDED] > 0.0)


class Recording(NamedTuple):
    """Readings without a restart between them, as they were taken."""

    rows: Rows
    output: Floats  # (N, OUTPUT_SIZE) after each of them, see :mod:`estimator.live.rows`
    changes: Sequence[int]  # the rows from which on they are another IMU's
    reports: Floats  # (M, REPORT_SIZE) by others, in the order in which it came
    last: Estimator  # the estimator behind the last one
    places: Any = slice(None)  # of the rows among those that were offered

    @property
    def bias_rad_s(self) -> Floats:
        """The gyroscope's bias (N, 3), as it was known then."""
        return self.output[:, BIAS]

    @property
    def rate_rad_s(self) -> Floats:
        """The gyroscope's rates (N, 3) less the bias."""
        return np.asarray(self.rows.gyr_rad_s - self.bias_rad_s)

    def last_rows(self, rows: Ints) -> Ints:
        """The last row of the same IMU, for each of these rows."""
        ends = np.array([*self.changes, len(self.output)])
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
        rows, output = cut(self.rows, begin, end), self.output[begin:end]
        return self._replace(rows=rows, output=output, changes=(), reports=NO_REPORT_ROWS)


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
        both = chosen(known_rows(*both[:2]), both, each)
    return both


def known_rows(q_ned_frd: Floats, sigma_rad: Floats) -> Bools:
    """Whether there is an attitude with its sigmas (N,)."""
    return np.asarray(np.isfinite(np.hstack([q_ned_frd, sigma_rad])).all(axis=1))


def chosen(rows: Bools, first: Estimates, second: Estimates) -> Estimates:
    """The first where ``rows`` (N,) are true, else the second."""
    each = rows[:, None]
    q, sigma = (np.where(each, *pair) for pair in zip(first[:2], second[:2], strict=True))
    return Estimates(q, sigma, np.where(rows, first.is_aided, second.is_aided))
