"""How readings turn against each other: a gyroscope beside a vector that others measure.

A vector v that stands still turns against the body: v' = -w x v. A gyroscope's rate is compared
with how a vector has changed between means that follow each other. A sensor may also be mounted
turned: by which right angle, a known field beside a compass's readings shows.
"""

from itertools import permutations, product
from math import sqrt

import numpy as np

from estimator.compilation.compiled import compiled, inlined, types_of
from estimator.geometry.quaternion import add, cross, norm, scale, square
from estimator.live.rows import NO_ROWS, Rows, reading_of
from estimator.types import ZERO_VEC3, Floats, Ints, Times, Vec3

SPAN_S = 0.05  # of the means that are compared: noise is less, turns are still small
SIZED = 500  # rows, from all of a recording, whose sizes are looked at
UPSIDE_DOWN = 0.5  # mean of the unit force's z; -1 stands level
MOST_SPANS = 100  # from all of the recording, however long it is
FEWEST_SPANS = 25  # that a comparison needs
SLOW_S = 0.1  # between samples: the turns are too large to be compared
MOST = 1e9  # beyond any reading in any unit
SPIKE = 5.0  # beyond so many times the larger turns one is none
LARGER = 0.95  # the share of turns that are smaller than those
UNCHANGED = 1e-18  # mean square change, in any unit, of a vector that stands still or is stuck
FLAT = 1e-9  # of the normal matrix: turns about one axis alone leave the iron along it open
LEAST_TURNS = 1e-200  # rad^2, beside them: there is an inverse without any turn

LEAST_READINGS = 50  # that show which way a compass is turned
# A right angle moves the field's horizontal part by more than this share of its strength where the
# vehicle turns; less shows nothing, and is iron.
LEAST_MISFIT = 0.15
CLEAR = 0.5  # of the misfit of any other way, at most

# The signed permutations of axes; as given first.
TURNS: Floats = np.array(
    [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3))
    ]
)
RIGHT_ANGLED: Floats = TURNS[np.linalg.det(TURNS) > 0.0]  # the first turns nothing


@inlined
def median(values: Floats | Ints) -> float:
    """The median, 0 of none; of a few hundred numpy's own takes five times as long."""
    ordered, n = np.sort(values), len(values)
    return float(0.5 * ordered[(n - 1) // 2] + 0.5 * ordered[n // 2]) if n else 0.0


@inlined
def _usual_step_s(times_us: Times) -> float:
    """The median time from one row to the next, of some hundred from all of them; 0 of one row."""
    at = _spread(len(times_us) - 1)
    return 1e-6 * median(times_us[at + 1] - times_us[at])


@compiled(types=lambda: types_of(NO_ROWS))
def usual_of(rows: Rows) -> tuple[float, float, float, bool]:
    """Medians of the step (s), of force and of field, 0 of none; whether forces point down.

    Force and field are in the recording's own units.
    """
    at: Ints = np.arange(0, len(rows.times_us), max(1, len(rows.times_us) // SIZED))
    forces, fields, beyond = np.zeros(len(at)), np.zeros(len(at)), 0.0
    for m, k in enumerate(at):
        _, _, force, field, has_mag = reading_of(rows, k)
        forces[m], fields[m] = norm(force), norm(field) if has_mag else MOST
        if 0.0 < forces[m] < MOST:
            beyond += force[2] / forces[m] - UPSIDE_DOWN
    acc_size, mag_size = median(forces[forces < MOST]), median(fields[fields < MOST])
    return _usual_step_s(rows.times_us), acc_size, mag_size, beyond > 0.0


@inlined
def _spread(n: int) -> Ints:
    """Some of the numbers from 0 to n - 1, all of them if they are few."""
    count = max(0, min(n, MOST_SPANS))
    return np.arange(count) * (n - 1) // max(1, count - 1)


@inlined
def _span(rows: Rows, numbers: Ints, is_field: bool) -> tuple[Vec3, Vec3, Vec3, float]:
    """Of one pair of means: angle, vector between, change, and the time that has passed."""
    n, passed_s, before_us, before = len(numbers) // 2, 0.0, 0, ZERO_VEC3
    angle = between = change = ZERO_VEC3
    for k, number in enumerate(numbers):
        time_us, rate, force, field, _ = reading_of(rows, number)
        part = scale(0.5 / n, field if is_field else force)
        between, change = add(between, part), add(change, scale(2.0 if k >= n else -2.0, part))
        # what turns between two rows is in the second half's mean for those that come behind it,
        # and not in the first half's for those before
        passed = 1e-6 / n * min(k, 2 * n - k) * (time_us - before_us)
        passed_s += passed
        if square(before) < MOST**2 and square(rate) < MOST**2:
            angle = add(angle, scale(0.5 * passed, add(before, rate)))
        before_us, before = time_us, rate
    return angle, between, change, passed_s


@compiled(types=lambda: types_of(NO_ROWS, True))
def spans_of(rows: Rows, is_field: bool) -> tuple[Floats, float]:
    """Pairs of means without a gap or a spike, none of a few; what the gyroscope leaves.

    A pair's row (9,) is the gyroscope's angle a from one mean to the next, in its unit times
    seconds, the change c of the vector, and the vector v between. What is left is the RMS share of
    the change that the gyroscope does not explain as given, 0 of none.
    """
    vectors = rows.mag_gauss if is_field else rows.acc_m_s2
    known = np.flatnonzero(np.isfinite(vectors[:, 0]) & (rows.has_mag | (not is_field)))
    step_s = _usual_step_s(rows.times_us[known])
    n = max(1, round(SPAN_S / step_s)) if 0.0 < step_s <= SLOW_S else len(known) + 1
    begins = 2 * n * _spread(len(known) // (2 * n))
    spans, sizes = np.zeros((len(begins), 9)), np.zeros(len(begins))
    whole, squares = np.zeros(len(begins), np.bool_), np.zeros((len(begins), 2))
    for m, begin in enumerate(begins):
        a, v, c, passed_s = _span(rows, known[begin : begin + 2 * n], is_field)
        sizes[m], is_reading = norm(a), square(a) + square(v) + square(c) < MOST**2
        whole[m] = is_reading and 0.0 < passed_s < 2.0 * n * step_s
        squares[m, 0], squares[m, 1] = square(add(c, cross(a, v))), square(c)
        spans[m] = np.array(a + c + v)
    if whole.any():
        whole &= sizes <= SPIKE * np.sort(sizes[whole])[int(LARGER * (whole.sum() - 1))]
    whole &= whole.sum() >= FEWEST_SPANS
    sums = squares[whole].sum(axis=0)
    return spans[whole], sqrt(sums[0] / sums[1]) if sums[1] > 0.0 else 0.0


def squares_left(spans: Floats, turns: Floats, *, has_offset: bool) -> Floats:
    """How much of the change a gyroscope leaves, turned by each of ``turns`` (W, 3, 3): (W, 2, 2).

    The share of the squares with its angles a times s is (1, s) F (1, s)^T: of |c + s a x v|^2, and
    with an offset of the least |c + s a x v + a x b|^2, b being hard iron, which stands still in
    the body; 0 of a vector that does not change.
    """
    a, c, v = spans[:, :3], spans[:, 3:6], spans[:, 6:]
    if not np.square(c).sum() > UNCHANGED * len(spans):
        return np.zeros((len(turns), 2, 2))
    a = a @ turns.swapaxes(1, 2)
    left = np.stack([np.broadcast_to(c, a.shape), np.cross(a, v)], axis=1)
    squares = np.einsum("wimk,wjmk->wij", left, left)
    if has_offset:  # N b = -sum of left x a
        N = (LEAST_TURNS + (1.0 + FLAT) * np.square(spans[:, :3]).sum()) * np.eye(3)
        N = N - a.swapaxes(1, 2) @ a
        along = np.cross(left, a[:, None]).sum(axis=2)
        squares -= along @ np.linalg.inv(N) @ along.swapaxes(1, 2)
    return np.asarray(squares / np.square(c).sum())


def roots(squares: Floats, *factors: float) -> Floats:
    """The share (F, W), RMS, that is left by angles times each factor, of :func:`squares_left`."""
    powers = np.array([(1.0, factor, factor, factor * factor) for factor in factors])
    return np.asarray(np.sqrt(np.maximum(powers @ squares.reshape(-1, 4).T, 0.0)))


def compass_turn(mag_gauss: Floats, expected_gauss: Floats) -> Floats | None:
    """The rotation (3, 3) that takes readings (N, 3) into the body's axes; None for none.

    ``expected_gauss`` (N, 3) is the place's field in the body's axes by an attitude whose heading
    the compass has not shown. A constant offset is left to the search for iron.
    """
    if len(mag_gauss) < LEAST_READINGS:
        return None
    misfits = np.empty(len(RIGHT_ANGLED))  # median distances, beyond a constant offset
    for k, R in enumerate(RIGHT_ANGLED):
        off = mag_gauss - expected_gauss @ R
        misfits[k] = np.median(np.linalg.norm(off - np.median(off, axis=0), axis=1))
    best, second = (int(k) for k in np.argsort(misfits)[:2])
    strength = float(np.median(np.linalg.norm(expected_gauss, axis=1)))
    is_clear = misfits[best] < CLEAR * misfits[second]
    if best == 0 or not is_clear or misfits[0] < LEAST_MISFIT * strength:
        return None
    return np.asarray(RIGHT_ANGLED[best])
