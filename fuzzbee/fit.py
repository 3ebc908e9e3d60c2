"""Whether a recording's units and axes fit each other, and which would fit better.

A vector that stands still turns against the body: v' = -w x v. What the gyroscope says is compared
with how the specific force, and the magnetic field without its hard iron, turn from each twentieth
of a second to the next, in every unit and with every axis and sign that data usually come in.
"""

from collections.abc import Iterator, Sequence
from itertools import permutations, product
from math import inf, nan, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.arrays import Floats, Times

LEAST_S = 5.0  # shorter recordings say too little
SPAN_S = 0.05  # of the means that are compared: noise is less, turns are still small
MOST_SPANS = 250  # from all of the recording, however long it is
SLOWEST_S = 2.0  # between samples: what is slower has another unit
MOST = 1e9  # beyond any reading in any unit
SLOW_S = 0.1  # between samples: the turns are too large to be compared
# Another way is believed if it leaves half as much, and the turning explains a third of the change.
BETTER = 2.0
EXPLAINED = 2.0 / 3.0
# Beside accelerations nothing is explained, but a unit that is too large makes it so much worse.
MUCH_BETTER = 8.0
SPIKE = 5.0  # beyond so many times the larger turns one is none
ALIKE = 1.05  # of two ways that leave as much the plainer one is told
UPSIDE_DOWN = 0.5  # mean of the unit force's z; -1 stands level

# Medians that the units have: an IMU in g has 1, the Earth's field is 0.22 to 0.67 gauss.
ACC_UNITS = (
    (0.5, 2.0, "acc * 9.80665 (g)"),
    (28.0, 38.0, "acc * 0.3048 (feet)"),
    (500.0, 2e3, "acc * 9.80665e-3 (mg)"),
)
MAG_UNITS = (
    (1.5e-5, 1e-4, "mag * 1e4 (tesla)"),
    (15.0, 100.0, "mag / 100 (microtesla)"),
    (150.0, 1e3, "mag / 1000 (milligauss)"),
    (1.5e4, 1e5, "mag / 1e5 (nanotesla)"),
)
GYR_UNITS = ((1.0, ""), (pi / 180.0, " * pi / 180"))
# What an accelerometer reads mostly, on the hardest flight; a field with any iron, normalised, too.
ACC_USUAL = (4.9, 19.6)
MAG_USUAL = (0.05, 5.0)
ALMOST_G = (8.5, 11.0)
# Between samples: what is quicker has another unit than seconds. From each on, time_s is in this.
FASTEST_S = 3e-5
TIME_UNITS = ((6e5, "nanoseconds", 1e9), (600.0, "microseconds", 1e6), (0.0, "milliseconds", 1e3))


class Way(NamedTuple):
    """How readings might have to be read: a signed permutation of axes, and a unit."""

    turn: NDArray[np.float64]  # (3, 3)
    scale: float
    unit: str

    def of(self, name: str) -> str:
        """As a program writes it."""
        order = np.argmax(np.abs(self.turn), axis=1).tolist()
        signs = [round(float(self.turn[k, place])) for k, place in enumerate(order)]
        axes = "" if order == [0, 1, 2] else f"[:, {order}]"
        return f"{name}{axes}{'' if signs == [1, 1, 1] else f' * {tuple(signs)}'}{self.unit}"


def _ways() -> Iterator[Way]:
    """As given first."""
    for scale, unit in GYR_UNITS:
        for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
            yield Way(np.diag(signs) @ np.eye(3)[list(order)], scale, unit)


WAYS = tuple(_ways())


class Spans(NamedTuple):
    """Turns between means that follow each other: angles in the gyroscope's unit times seconds."""

    angle: Floats
    vector: Floats  # between the two
    change: Floats

    @property
    def still(self) -> float:
        """How much changes, RMS."""
        return float(np.sqrt(np.mean(np.sum(self.change**2, axis=1))))


def advice(times_us: Times, gyr: Floats, acc: Floats, mag: Floats) -> tuple[str, ...]:
    """Lines for a person, each with what would fit better; none of a recording that is sound.

    ``mag`` (N, 3) is NaN where there is none.
    """
    if len(times_us) > 4 * MOST_SPANS and 0.0 < 1e-6 * _step_us(times_us) < FASTEST_S:
        return (f"samples are {1e-6 * _step_us(times_us):.1g} s apart: time_s counts seconds",)
    if not is_enough(times_us):
        return ()
    step_s = 1e-6 * _step_us(times_us)
    if step_s < 0.0:
        return ("time_s runs backwards: [::-1] of all arrays would turn it round",)
    found = []
    if step_s > SLOW_S:
        unit, divisor = next(each[1:] for each in TIME_UNITS if step_s > each[0])
        true_s = _true_step_s(times_us, step_s, gyr, (mag, acc))
        is_unit = BETTER > true_s * divisor / step_s > 1.0 / BETTER
        if step_s > SLOWEST_S or is_unit:
            found = [f"samples are {step_s:.3g} s apart: {unit} want time_s / {divisor:g}"]
        elif BETTER * true_s < step_s:
            found = [f"samples are {step_s:.3g} s apart and turn as if {true_s:.2g} s were between"]
        if found:
            times_us = np.rint(times_us * min(1.0, true_s / step_s)).astype(np.int64)
    if not gyr.any():
        found.append("the gyroscope reads nothing but 0")
    swapped = [*_swapped(gyr, acc, mag)]
    found += swapped or [
        *_unit("accelerometer", acc, ACC_UNITS, ACC_USUAL),
        *_unit("magnetometer", mag, MAG_UNITS, MAG_USUAL),
        *_axes(times_us, gyr, acc, mag),
        *_upside_down(acc),
    ]
    return tuple(found)


def is_enough(times_us: Times) -> bool:
    """Whether a recording is long enough to be judged."""
    return len(times_us) > 2 and 1e-6 * abs(int(times_us[-1] - times_us[0])) >= LEAST_S


def _step_us(times_us: Times) -> float:
    """The usual time from one to the next."""
    some = np.linspace(0, len(times_us) - 2, min(len(times_us) - 1, 4 * MOST_SPANS)).astype(int)
    return float(np.median(times_us[some + 1] - times_us[some]))


def _size(readings: Floats) -> float:
    """The median length; 0 of none."""
    sizes = np.linalg.norm(_some(readings), axis=1)
    sizes = sizes[np.isfinite(sizes)]
    return float(np.median(sizes)) if sizes.size else 0.0


def _unit(
    what: str,
    readings: Floats,
    units: tuple[tuple[float, float, str], ...],
    usual: tuple[float, float],
) -> Iterator[str]:
    size = _size(readings)
    for low, high, better in units:
        if low <= size <= high:
            yield f"the {what} reads {size:.3g} mostly, which would fit as {better}"
            return
    if np.isfinite(readings).any() and not usual[0] <= size <= usual[1]:
        yield f"the {what} reads {size:.3g} mostly, {usual[0]:g} to {usual[1]:g} is usual"


def _swapped(gyr: Floats, acc: Floats, mag: Floats) -> Iterator[str]:
    """Whether another sensor reads what the accelerometer should; one that turns so fast varies."""
    size = _size(acc)
    if ACC_USUAL[0] <= size <= ACC_USUAL[1]:
        return
    turns = np.linalg.norm(_some(gyr), axis=1)
    is_steady = np.mean((ALMOST_G[0] <= turns) & (turns <= ALMOST_G[1])) > EXPLAINED
    has_field = MAG_USUAL[0] <= size <= MAG_USUAL[1]
    for name, readings, is_force in (
        ("gyr", gyr, is_steady),
        ("mag", mag, has_field and ACC_USUAL[0] <= _size(mag) <= ACC_USUAL[1]),
    ):
        if is_force:
            yield f"{name} reads {_size(readings):.3g} mostly, as acc should: they may be swapped"


def _upside_down(acc: Floats) -> Iterator[str]:
    some = _some(acc)
    sizes = np.linalg.norm(some, axis=1)
    known = np.isfinite(sizes) & (sizes > 0.0)
    if known.any() and float(np.mean(some[known, 2] / sizes[known])) > UPSIDE_DOWN:
        yield (
            "the vehicle is upside down most of the time: data in x forward, y left, z up want"
            " * (1, -1, -1) for all three, gravity instead of specific force wants acc * -1"
        )


def _some(readings: Floats) -> Floats:
    """Rows from all of the recording, enough for a mean."""
    return _sound(readings[:: max(1, len(readings) // (4 * MOST_SPANS))])


def _sound(readings: Floats) -> Floats:
    """Without what is beyond any reading."""
    sound: Floats = np.where(np.abs(readings) < MOST, readings, nan)
    return sound


def _axes(times_us: Times, gyr: Floats, acc: Floats, mag: Floats) -> Iterator[str]:
    """What the turning of field and force says of the gyroscope, or of the field's axes."""
    force, field = _both_spans(times_us, gyr, (acc, mag))
    for what, spans, has_offset in (
        ("magnetometer", field, True),
        ("accelerometer", force, False),
    ):
        left = None if spans is None else _left(spans, WAYS[:1], has_offset=has_offset)
        if spans is None or left is None or left[0] <= EXPLAINED * spans.still:
            continue
        left = _left(spans, WAYS, has_offset=has_offset)
        way = WAYS[int(np.flatnonzero(left <= ALIKE * left.min())[0])]
        scale, scaled = _best_scale(spans, has_offset=has_offset)
        is_other = max(scale, 1.0 / max(scale, 1e-9)) > BETTER and scaled <= EXPLAINED * spans.still
        is_scale = is_other and BETTER * scaled < left.min()
        times = float(left[0] / max(scaled if is_scale else left.min(), 1e-9))
        agree = f"gyroscope and {what} agree {times:.{0 if times > 10.0 else 1}f} times better with"
        if is_scale:
            yield f"{agree} gyr * {float(f'{scale:.2g}'):g}: its unit, or the times, are others"
            return
        is_explained = times > BETTER and left.min() <= EXPLAINED * spans.still
        is_unit = times > MUCH_BETTER and way.scale != 1.0
        if not (is_explained or is_unit):
            continue
        better = way.of("gyr") if is_explained else f"gyr{way.unit}"
        if has_offset and way.scale == 1.0 and np.linalg.det(way.turn) > 0.0:
            # a rotation: the axes of either may be others
            better = f"{Way(way.turn.T, 1.0, '').of('mag')}, or with {better}"
        yield f"{agree} {better}"
        return


def _true_step_s(times_us: Times, step_s: float, gyr: Floats, both: tuple[Floats, Floats]) -> float:
    """The time between samples by how vectors turn; that given, if they do not tell."""
    best, true_s = EXPLAINED, step_s
    for tried_s, vectors in product((0.001, 0.004, 0.016), both):
        shrunk = tried_s / step_s
        known = np.flatnonzero(np.isfinite(vectors[:, 0]))
        turns = _turns(np.rint(times_us * shrunk).astype(np.int64), gyr, known)
        spans = _spans(turns, vectors)
        if spans is None:
            continue
        scale, left = _best_scale(spans, has_offset=False)
        if scale > 0.0 and left <= best * spans.still:
            best, true_s = left / spans.still, tried_s * scale
    return true_s


def _best_scale(spans: Spans, *, has_offset: bool) -> tuple[float, float]:
    """What the angles times which number leave least of the change, and how much, RMS."""
    angle, vector, change = spans
    columns = [np.cross(angle, vector)]
    if has_offset:  # hard iron b stands still in the body: c + s w x (v - b)
        columns += [np.cross(angle, axis) for axis in np.eye(3)]
    rows = np.stack(columns, axis=2).reshape(-1, len(columns))
    found = np.linalg.lstsq(rows, -change.ravel(), rcond=None)[0]
    left = change.ravel() + rows @ found
    return float(found[0]), float(np.sqrt(np.sum(left**2) / len(angle)))


def _both_spans(
    times_us: Times, gyr: Floats, both: tuple[Floats, Floats]
) -> tuple[Spans | None, Spans | None]:
    """Those of two sensors, which mostly are read together: then with the same turns."""
    first, second = (np.flatnonzero(np.isfinite(vectors[:, 0])) for vectors in both)
    turns = _turns(times_us, gyr, first)
    others = turns if np.array_equal(first, second) else _turns(times_us, gyr, second)
    return _spans(turns, both[0]), _spans(others, both[1])


class Turns(NamedTuple):
    """Pairs of means over :data:`SPAN_S`: their samples, the turn from each to the other."""

    rows: NDArray[np.int64]  # (pairs, samples of both)
    angles: Floats  # (pairs, 3)
    is_whole: NDArray[np.bool_]  # (pairs,) without a gap


def _turns(times_us: Times, gyr: Floats, known: NDArray[np.int64]) -> Turns | None:
    """Both means are of so many vectors in a row, which are ``known``; None of too few."""
    step_s = 1e-6 * _step_us(times_us[known]) if len(known) > 1 else inf
    if not 0.0 < step_s <= SLOW_S:
        return None
    n = max(1, round(SPAN_S / step_s))
    pairs = len(known) // (2 * n)
    chosen = min(pairs, MOST_SPANS)
    begins = 2 * n * (np.arange(chosen) * max(0, pairs - 1) // max(1, chosen - 1))
    of_pairs = known[begins[:, None] + np.arange(2 * n)]
    times_s: Floats = 1e-6 * (times_us[of_pairs] - times_us[of_pairs[:, :1]]).astype(float)
    passed_s = np.diff(_means(times_s), axis=1)[:, 0]
    angles = np.diff(_means(_turned(times_s, _sound(gyr[of_pairs]))), axis=1)[:, 0]
    return Turns(of_pairs, angles, (passed_s > 0.0) & (passed_s < 2.0 * n * step_s))


def _means(values: Floats) -> Floats:
    """Of the first half of each row and of the second, (rows, 2, ...)."""
    halves = values.reshape(len(values), 2, values.shape[1] // 2, *values.shape[2:])
    mean: Floats = halves.mean(axis=2)
    return mean


def _spans(turns: Turns | None, vectors: Floats) -> Spans | None:
    """Means over :data:`SPAN_S` and those that follow them; None where there are too few.

    A pair with a gap is left out.
    """
    if turns is None:
        return None
    vector = _means(_sound(vectors[turns.rows]))
    usable = turns.is_whole & np.isfinite(vector).all(axis=(1, 2))
    if np.count_nonzero(usable) < LEAST_S / SLOW_S / 2.0:
        return None
    angles, vector = turns.angles[usable], vector[usable]
    sizes = np.linalg.norm(angles, axis=1)
    true = sizes <= SPIKE * np.percentile(sizes, 95)
    return Spans(angles[true], vector.mean(axis=1)[true], (vector[:, 1] - vector[:, 0])[true])


def _turned(times_s: Floats, gyr: Floats) -> Floats:
    """The gyroscope's integral along the second axis, 0 at its beginning."""
    steps = 0.5 * (gyr[:, 1:] + gyr[:, :-1]) * np.diff(times_s)[:, :, None]
    steps[~np.isfinite(steps)] = 0.0
    return np.concatenate((np.zeros_like(gyr[:, :1]), np.cumsum(steps, axis=1)), axis=1)


def _left(spans: Spans, ways: Sequence[Way], *, has_offset: bool) -> Floats:
    """How much of the change each way leaves, RMS (len(ways),).

    Of the spans only sums over products count, the same for all ways: with A for a way, the angle w
    and a = A w, sum |c + a x v|^2 = sum |c|^2 + 2 a . (v x c) + |a|^2 |v|^2 - (a . v)^2.
    """
    angle, vector, change = spans
    turns = np.array([way.scale * way.turn for way in ways])
    scales = np.array([way.scale for way in ways]) ** 2
    angles = np.sum(angle**2, axis=1)
    square = np.sum(change**2) + 2.0 * np.einsum(
        "cij,ij->c", turns, np.cross(vector, change).T @ angle
    )
    square += scales * (angles @ np.sum(vector**2, axis=1))
    both = (vector[:, :, None] * angle[:, None, :]).reshape(len(angle), 9)
    flat = turns.reshape(len(ways), 9)
    square -= np.einsum("ci,ij,cj->c", flat, both.T @ both, flat)
    if has_offset:  # hard iron b stands still in the body: c + a x (v - b)
        eye = scales[:, None, None] * angles.sum() * np.eye(3)
        normal = eye - turns @ (angle.T @ angle) @ turns.transpose(0, 2, 1)
        seen = scales[:, None] * (angles @ vector) - _crossed(turns @ (angle.T @ change))
        products = (angle.T @ both).reshape(3, 3, 3)  # of w, v and w
        seen -= np.einsum("cim,ckn,mkn->ci", turns, turns, products)
        offset = np.linalg.solve(normal + 1e-12 * np.eye(3), seen[:, :, None])[:, :, 0]
        square -= np.sum(seen * offset, axis=1)
    left: Floats = np.sqrt(np.maximum(square, 0.0) / len(angle))
    return left


def _crossed(products: Floats) -> Floats:
    """The sums of a x c, of those of a c^T (ways, 3, 3)."""
    apart = products - products.transpose(0, 2, 1)
    return np.stack((apart[:, 1, 2], apart[:, 2, 0], apart[:, 0, 1]), axis=1)
