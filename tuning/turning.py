"""How readings turn against each other, in compiled passes over a recording's columns.

A vector v that stands still turns against the body: v' = -w x v. What a gyroscope says is compared
with how a vector has changed between means that follow each other.
"""

from itertools import permutations, product
from typing import NamedTuple

import numpy as np

from estimator.arrays import Bools, Floats, Ints, Times
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import types_of
from estimator.geometry.quaternion import add, cross, dot, norm, scale, subtract
from estimator.types import Vec3

SPAN_S = 0.05  # of the means that are compared: noise is less, turns are still small
MOST_SPANS = 250  # from all of the recording, however long it is
SLOW_S = 0.1  # between samples: the turns are too large to be compared
MOST = 1e9  # beyond any reading in any unit
SPIKE = 5.0  # beyond so many times the larger turns one is none
LARGER = 0.95  # the share of turns that are smaller than those
ALMOST_G = (8.5, 11.0)  # m/s^2
FLAT = 1e-9  # of the normal matrix: turns about one axis alone leave the iron along it open

_COLUMNS = np.zeros((1, 3))
_TIMES, _ROWS = np.zeros(1, np.int64), np.zeros(1, np.bool_)


# The signed permutations of axes; as given first.
TURNS: Floats = np.array(
    [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)


class Sizes(NamedTuple):
    """What columns hold: medians of the step (us) and of lengths, 0 of none, in their own units.

    ``steady`` is the share of rates whose length would fit gravity in m/s^2, ``down`` the mean z of
    the force's unit vector, NaN of none.
    """

    step_us: float
    gyr: float
    acc: float
    mag: float
    steady: float
    down: float


class Spans(NamedTuple):
    """Turns between means that follow each other: angles in the gyroscope's unit times seconds."""

    angle: Floats  # (M, 3)
    vector: Floats  # (M, 3) between the two
    change: Floats  # (M, 3)
    still: float  # RMS of the change


@compiled(types=lambda: types_of(_TIMES, _COLUMNS, _COLUMNS, _COLUMNS, _ROWS))
def sizes_of(times_us: Times, gyr: Floats, acc: Floats, mag: Floats, has_mag: Bools) -> Sizes:
    """The sizes of some thousand rows from all of a recording (N, 3), N at least 2."""
    every = max(1, len(times_us) // (4 * MOST_SPANS))
    count = (len(times_us) + every - 1) // every
    lengths = np.empty((3, count))
    found = np.zeros(3, np.int64)
    steady, down = 0, 0.0
    for row in range(0, len(times_us), every):
        rate, force, field = _vector(gyr, row), _vector(acc, row), _vector(mag, row)
        steady += ALMOST_G[0] <= norm(rate) <= ALMOST_G[1]
        for k, reading in enumerate((rate, force, field)):
            if _is_sound(reading) and (k < 2 or has_mag[row]):
                lengths[k, found[k]] = norm(reading)
                found[k] += 1
        if _is_sound(force) and norm(force) > 0.0:
            down += force[2] / norm(force)
    forces = np.count_nonzero(lengths[1, : found[1]])
    return Sizes(
        _step_us(times_us, np.arange(len(times_us))),
        _median(lengths[0, : found[0]]),
        _median(lengths[1, : found[1]]),
        _median(lengths[2, : found[2]]),
        steady / count,
        down / forces if forces else np.nan,
    )


@inlined
def _vector(rows: Floats, k: int) -> Vec3:
    return (rows[k, 0], rows[k, 1], rows[k, 2])


@inlined
def _is_sound(v: Vec3) -> bool:
    return abs(v[0]) < MOST and abs(v[1]) < MOST and abs(v[2]) < MOST


@inlined
def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else 0.0


@inlined
def _step_us(times_us: Times, known: Ints) -> float:
    """The usual time from one of the known rows to the next."""
    count = min(len(known) - 1, MOST_SPANS)
    steps = np.empty(count)
    for k in range(count):
        at = k * (len(known) - 2) // max(1, count - 1)
        steps[k] = times_us[known[at + 1]] - times_us[known[at]]
    return _median(steps)


@compiled(types=lambda: types_of(_TIMES, _COLUMNS, _COLUMNS, _ROWS))
def spans_of(times_us: Times, gyr: Floats, vectors: Floats, has_vector: Bools) -> Spans:
    """Pairs of means over :data:`SPAN_S`, without those with a gap or a spike; none if too slow."""
    known = np.flatnonzero(has_vector & np.isfinite(vectors[:, 0]))
    step_s = 1e-6 * _step_us(times_us, known) if len(known) > 1 else 0.0
    n = max(1, round(SPAN_S / step_s)) if 0.0 < step_s <= SLOW_S else len(known) + 1
    pairs = len(known) // (2 * n)
    chosen, found = min(pairs, MOST_SPANS), 0
    angle, vector, change = np.empty((chosen, 3)), np.empty((chosen, 3)), np.empty((chosen, 3))
    sizes = np.empty(chosen)
    for k in range(chosen):
        begin = 2 * n * (k * (pairs - 1) // max(1, chosen - 1))
        rows = known[begin : begin + 2 * n]
        passed_s, turned = _turn(times_us, gyr, rows)
        first, second = _mean(vectors, rows[:n]), _mean(vectors, rows[n:])
        is_whole = 0.0 < passed_s < 2.0 * n * step_s
        if is_whole and _is_sound(first) and _is_sound(second):
            angle[found], sizes[found] = turned, norm(turned)
            vector[found] = scale(0.5, add(first, second))
            change[found] = subtract(second, first)
            found += 1
    largest = SPIKE * np.sort(sizes[:found])[int(LARGER * (found - 1))] if found else 0.0
    true = sizes[:found] <= largest
    changed = change[:found][true]
    still = np.sqrt(np.sum(changed * changed) / max(1, len(changed)))
    return Spans(angle[:found][true], vector[:found][true], changed, still)


@inlined
def _turn(times_us: Times, gyr: Floats, rows: Ints) -> tuple[float, Vec3]:
    """Between the mean of the first half of the rows and that of the second: seconds, and angle."""
    n = len(rows) // 2
    passed_s, angle, before = 0.0, (0.0, 0.0, 0.0), _vector(gyr, rows[0])
    for k in range(1, 2 * n):
        rate = _vector(gyr, rows[k])
        # what turns between two rows is in the second half's mean for those that come behind it,
        # and not in the first half's for those before
        passed = min(k, 2 * n - k) * 1e-6 / n * (times_us[rows[k]] - times_us[rows[k - 1]])
        passed_s += passed
        if _is_sound(rate) and _is_sound(before):
            angle = add(angle, scale(0.5 * passed, add(rate, before)))
        before = rate
    return passed_s, angle


@inlined
def _mean(vectors: Floats, rows: Ints) -> Vec3:
    whole = (0.0, 0.0, 0.0)
    for row in rows:
        whole = add(whole, _vector(vectors, row))
    return scale(1.0 / len(rows), whole)


@compiled(
    types=lambda: types_of(Spans(_COLUMNS, _COLUMNS, _COLUMNS, 0.0), np.zeros((1, 3, 3)), True)
)
def squares_left(spans: Spans, turns: Floats, has_offset: bool) -> Floats:
    """How much of the change a gyroscope leaves, turned by each of ``turns`` (W, 3, 3): (W, 3).

    The mean square with its angles times s is f[0] + 2 s f[1] + s^2 f[2]: of |c + s a x v|^2, and
    with an offset of the least |c + s a x v + a x b|^2, b being hard iron, which stands still in
    the body.
    """
    found = np.empty((len(turns), 3))
    for way in range(len(turns)):
        found[way] = _square_left(spans, turns[way], has_offset)
    return found


@inlined
def _square_left(spans: Spans, turn: Floats, has_offset: bool) -> Vec3:
    f0 = f1 = f2 = 0.0
    u, v = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)  # sums of c x a and (a x v) x a
    squares, products = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)  # of a: xx, yy, zz and yz, zx, xy
    for k in range(len(spans.angle)):
        w, change = _vector(spans.angle, k), _vector(spans.change, k)
        x = turn[0, 0] * w[0] + turn[0, 1] * w[1] + turn[0, 2] * w[2]
        y = turn[1, 0] * w[0] + turn[1, 1] * w[1] + turn[1, 2] * w[2]
        z = turn[2, 0] * w[0] + turn[2, 1] * w[1] + turn[2, 2] * w[2]
        turned = cross((x, y, z), _vector(spans.vector, k))
        f0 += dot(change, change)
        f1 += dot(change, turned)
        f2 += dot(turned, turned)
        u = subtract(u, cross((x, y, z), change))
        v = subtract(v, cross((x, y, z), turned))
        squares = (squares[0] + x * x, squares[1] + y * y, squares[2] + z * z)
        products = (products[0] + y * z, products[1] + z * x, products[2] + x * y)
    if has_offset:
        of_u, of_v = _offset(squares, products, u), _offset(squares, products, v)
        f0, f1, f2 = f0 - dot(of_u, u), f1 - dot(of_u, v), f2 - dot(of_v, v)
    count = max(1, len(spans.angle))
    return f0 / count, f1 / count, f2 / count


@inlined
def _offset(squares: Vec3, products: Vec3, right: Vec3) -> Vec3:
    """b of N b = right, N = sum |a|^2 1 - a a^T."""
    whole = (1.0 + FLAT) * (squares[0] + squares[1] + squares[2])
    rows = (
        (whole - squares[0], -products[2], -products[1]),
        (-products[2], whole - squares[1], -products[0]),
        (-products[1], -products[0], whole - squares[2]),
    )
    across = (cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1]))
    volume = dot(rows[0], across[0])
    if not volume > 0.0:
        return (0.0, 0.0, 0.0)
    return (
        dot(across[0], right) / volume,
        dot(across[1], right) / volume,
        dot(across[2], right) / volume,
    )


def root(squares: Floats, factor: float = 1.0) -> Floats:
    """RMS (W,) of what is left by angles times ``factor``, of :func:`squares_left`."""
    left = squares @ np.array((1.0, 2.0 * factor, factor * factor))
    return np.asarray(np.sqrt(np.maximum(left, 0.0)))
