"""How readings turn against each other: a gyroscope beside a vector that others measure.

A vector v that stands still turns against the body: v' = -w x v. What a gyroscope says is compared
with how a vector has changed between means that follow each other.
"""

from typing import NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats, Ints, Times

SPAN_S = 0.05  # of the means that are compared: noise is less, turns are still small
MOST_SPANS = 100  # from all of the recording, however long it is
SLOW_S = 0.1  # between samples: the turns are too large to be compared
MOST = 1e9  # beyond any reading in any unit
SPIKE = 5.0  # beyond so many times the larger turns one is none
LARGER = 0.95  # the share of turns that are smaller than those
FLAT = 1e-9  # of the normal matrix: turns about one axis alone leave the iron along it open


class Spans(NamedTuple):
    """Turns between means that follow each other: angles in the gyroscope's unit times seconds."""

    angle: Floats  # (M, 3)
    vector: Floats  # (M, 3) between the two
    change: Floats  # (M, 3)

    @property
    def still(self) -> float:
        """The RMS change."""
        return float(np.sqrt(np.sum(self.change**2) / max(1, len(self.change))))


def usual_step_us(times_us: Times) -> float:
    """The median time from one row to the next, of some hundred from all of them; 0 of one row."""
    at = _spread(len(times_us) - 1)
    return float(np.median(times_us[at + 1] - times_us[at])) if len(at) else 0.0


def _spread(n: int) -> Ints:
    """Some of the numbers from 0 to n - 1, all of them if they are few."""
    count = max(0, min(n, MOST_SPANS))
    return np.asarray(np.arange(count) * (n - 1) // max(1, count - 1))


def spans_of(times_us: Times, gyr: Floats, vectors: Floats, has_vector: Bools) -> Spans:
    """Pairs of means over :data:`SPAN_S`, without those with a gap or a spike; none if too slow."""
    known = np.flatnonzero(has_vector & np.isfinite(vectors[:, 0]))
    step_s = 1e-6 * usual_step_us(times_us[known])
    n = max(1, round(SPAN_S / step_s)) if 0.0 < step_s <= SLOW_S else 0
    if len(known) < 2 * n or n == 0:
        return Spans(*np.zeros((3, 0, 3)))
    k = np.arange(2 * n)
    rows = known[2 * n * _spread(len(known) // (2 * n))[:, None] + k]  # (M, 2 n)
    # what turns between two rows is in the second half's mean for those that come behind it, and
    # not in the first half's for those before
    share = np.minimum(k, 2 * n - k)[1:] * 1e-6 / n
    with np.errstate(all="ignore"):  # numbers that are no readings
        passed = share * np.diff(times_us[rows], axis=1)
        rates, means = gyr[rows], vectors[rows].reshape(len(rows), 2, n, 3).mean(axis=2)
        rates[~(np.linalg.norm(rates, axis=2) < MOST)] = np.nan
        angle = np.nansum(passed[:, :, None] * 0.5 * (rates[:, 1:] + rates[:, :-1]), axis=1)
        found = (angle, means.mean(axis=1), means[:, 1] - means[:, 0])
        sizes, passed_s = np.linalg.norm(angle, axis=1), passed.sum(axis=1)
    whole = (passed_s > 0.0) & (passed_s < 2.0 * n * step_s)
    whole &= (np.abs(np.concatenate(found, axis=1)) < MOST).all(axis=1)
    if whole.any():
        larger = np.sort(sizes[whole])[int(LARGER * (whole.sum() - 1))]
        whole &= sizes <= SPIKE * larger
    return Spans(*(each[whole] for each in found))


def squares_left(spans: Spans, turns: Floats, *, has_offset: bool) -> Floats:
    """How much of the change a gyroscope leaves, turned by each of ``turns`` (W, 3, 3): (W, 3).

    The mean square with its angles a times s is f[0] + 2 s f[1] + s^2 f[2]: of |c + s a x v|^2, and
    with an offset of the least |c + s a x v + a x b|^2, b being hard iron, which stands still in
    the body. All that the turns need are moments of a, v and c.
    """
    a, v, c = spans
    flat, a_squared = turns.reshape(-1, 9), np.sum(a * a, axis=1)
    moments = np.einsum("mi,mj->mij", v, a).reshape(-1, 9)  # v . T a is their sum with T
    f0 = np.full(len(turns), np.sum(c * c))
    f1 = flat @ (np.cross(v, c).T @ a).ravel()
    f2 = a_squared @ np.sum(v * v, axis=1) - np.sum((moments @ flat.T) ** 2, axis=0)
    if has_offset and len(a):
        # N b = -u - s w, with N = sum |a|^2 1 - a a^T, u = sum c x a and w = sum (a x v) x a
        m, pairs = c.T @ a @ turns.transpose(0, 2, 1), ((1, 2), (2, 0), (0, 1))
        u = np.stack([m[:, i, j] - m[:, j, i] for i, j in pairs], axis=1)
        w = a_squared @ v - np.einsum("tij,jt->ti", turns, a.T @ moments @ flat.T)
        inverse = np.linalg.pinv((1.0 + FLAT) * np.sum(a_squared) * np.eye(3) - a.T @ a)
        u, w = (np.einsum("tij,ti->tj", turns, each) for each in (u, w))
        f0 = f0 - np.sum(u @ inverse * u, axis=1)
        f1 = f1 - np.sum(u @ inverse * w, axis=1)
        f2 = f2 - np.sum(w @ inverse * w, axis=1)
    return np.column_stack((f0, f1, f2)) / max(1, len(a))


def root(squares: Floats, factor: float = 1.0) -> Floats:
    """RMS (W,) of what is left by angles times ``factor``, of :func:`squares_left`."""
    left = squares @ np.array((1.0, 2.0 * factor, factor * factor))
    return np.asarray(np.sqrt(np.maximum(left, 0.0)))
