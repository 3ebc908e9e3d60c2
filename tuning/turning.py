"""How readings turn against each other: a gyroscope beside a vector that others measure.

A vector v that stands still turns against the body: v' = -w x v. What a gyroscope says is compared
with how a vector has changed between means that follow each other.
"""

from typing import NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats, Ints, Times
from estimator.compilation.compiled import compiled, inlined, types_of
from estimator.geometry.quaternion import add, norm, scale, subtract
from estimator.types import Vec3

SPAN_S = 0.05  # of the means that are compared: noise is less, turns are still small
MOST_SPANS = 100  # from all of the recording, however long it is
SLOW_S = 0.1  # between samples: the turns are too large to be compared
MOST = 1e9  # beyond any reading in any unit
SPIKE = 5.0  # beyond so many times the larger turns one is none
LARGER = 0.95  # the share of turns that are smaller than those
FLAT = 1e-9  # of the normal matrix: turns about one axis alone leave the iron along it open

_COLUMNS, _TIMES = np.zeros((1, 3)), np.zeros(1, np.int64)


class Spans(NamedTuple):
    """Turns between means that follow each other: angles in the gyroscope's unit times seconds."""

    angle: Floats  # (M, 3)
    vector: Floats  # (M, 3) between the two
    change: Floats  # (M, 3)

    @property
    def still(self) -> float:
        """The RMS change."""
        return float(np.sqrt(np.sum(self.change**2) / max(1, len(self.change))))


@inlined
def vector_of(rows: Floats, k: int) -> Vec3:
    """A row of (N, 3)."""
    return (rows[k, 0], rows[k, 1], rows[k, 2])


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
    n = max(1, round(SPAN_S / step_s)) if 0.0 < step_s <= SLOW_S else len(known) + 1
    pairs = len(known) // (2 * n)
    found = turns_of(times_us, gyr, vectors, known, 2 * n * _spread(pairs), n)
    passed_s, sizes = found[:, 0], np.linalg.norm(found[:, 1:4], axis=1)
    whole = (passed_s > 0.0) & (passed_s < 2.0 * n * step_s)
    whole &= (np.abs(found) < MOST).all(axis=1)
    if whole.any():
        larger = np.sort(sizes[whole])[int(LARGER * (whole.sum() - 1))]
        whole &= sizes <= SPIKE * larger
    return Spans(*(found[whole, at : at + 3] for at in (1, 4, 7)))


@compiled(types=lambda: types_of(_TIMES, _COLUMNS, _COLUMNS, _TIMES, _TIMES, 1))
def turns_of(
    times_us: Times, gyr: Floats, vectors: Floats, known: Ints, first: Ints, n: int
) -> Floats:
    """Of 2 n ``known`` rows from each of ``first`` (M,) on, M rows of ten numbers.

    They are the seconds between the mean of the first half and that of the second, the angle that
    the gyroscope turns by meanwhile, the mean vector and its change.
    """
    found = np.empty((len(first), 10))
    for m in range(len(first)):
        rows = known[first[m] : first[m] + 2 * n]
        passed_s, angle, before = 0.0, (0.0, 0.0, 0.0), vector_of(gyr, rows[0])
        early, late = vector_of(vectors, rows[0]), (0.0, 0.0, 0.0)
        for k in range(1, 2 * n):
            rate, vector = vector_of(gyr, rows[k]), vector_of(vectors, rows[k])
            # what turns between two rows is in the second half's mean for those that come behind
            # it, and not in the first half's for those before
            passed = min(k, 2 * n - k) * 1e-6 / n * (times_us[rows[k]] - times_us[rows[k - 1]])
            passed_s += passed
            if norm(rate) < MOST and norm(before) < MOST:
                angle = add(angle, scale(0.5 * passed, add(rate, before)))
            before = rate
            if k < n:
                early = add(early, vector)
            else:
                late = add(late, vector)
        between, change = scale(0.5 / n, add(early, late)), scale(1.0 / n, subtract(late, early))
        found[m, 0] = passed_s
        for i in range(3):
            found[m, 1 + i], found[m, 4 + i], found[m, 7 + i] = angle[i], between[i], change[i]
    return found


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
        u = _axial(c.T @ a @ turns.transpose(0, 2, 1))
        w = a_squared @ v - np.einsum("tij,jt->ti", turns, a.T @ moments @ flat.T)
        inverse = np.linalg.pinv((1.0 + FLAT) * np.sum(a_squared) * np.eye(3) - a.T @ a)
        u, w = (np.einsum("tij,ti->tj", turns, each) for each in (u, w))
        f0 = f0 - np.sum(u @ inverse * u, axis=1)
        f1 = f1 - np.sum(u @ inverse * w, axis=1)
        f2 = f2 - np.sum(w @ inverse * w, axis=1)
    return np.column_stack((f0, f1, f2)) / max(1, len(a))


def _axial(m: Floats) -> Floats:
    """Sums of x cross y (W, 3) of those of the products x y^T (W, 3, 3)."""
    pairs = ((1, 2), (2, 0), (0, 1))
    return np.stack([m[:, i, j] - m[:, j, i] for i, j in pairs], axis=1)


def root(squares: Floats, factor: float = 1.0) -> Floats:
    """RMS (W,) of what is left by angles times ``factor``, of :func:`squares_left`."""
    left = squares @ np.array((1.0, 2.0 * factor, factor * factor))
    return np.asarray(np.sqrt(np.maximum(left, 0.0)))
