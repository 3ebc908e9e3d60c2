"""The fuzzy rules of many candidates side by side, without branches: ``fuzzy.py`` in lanes.

The centroid there walks along the aggregate, and where it walks differs from step to step. Here
the same area and moment are a sum of the same terms each time. At level y the aggregate is the
union of the intervals [a + y (b - a), c - y (c - b)] of the sets that are stronger than y. By
inclusion and exclusion its length is the sum of the intervals' lengths, less what each two have
in common, plus what each three have. What sets have in common lies left of their lowest right end
and right of their highest left end. Both are straight lines in y, but for one level where another
set's end takes over, and they meet at a level that no strength moves. So each term's integral, up
to the weakest of its strengths, is a polynomial whose coefficients are laid down beforehand.

By the bounds of k12..k22 only neighbours' ends change places, and only these sets meet: two
neighbours, two with one between them (VS-M, S-L, M-VL), and three in a row.
"""

import numpy as np
from numpy.typing import NDArray

from estimator.compilation.compiled import inlined
from estimator.filter.fuzzy import Strengths, fire
from estimator.filter.memberships import Memberships, Triangle, fuzzy_sets

Array = NDArray[np.float64]

# Candidates side by side. A row is one quantity of each.
LANES = 8

# The rows of an input set: its corners, and its slopes
A, B, C, RISE, FALL = (LANES * i for i in range(5))
INPUT = 5 * LANES
# The rows of a term: the level where it ends; area and moment in powers of the level
END, AREA1, AREA2, MOMENT1, MOMENT2, MOMENT3 = (LANES * i for i in range(6))
STRAIGHT = 6 * LANES
# and, where ends may change places: the level, and what comes in from there on, for each end
RIGHT, LEFT = STRAIGHT, STRAIGHT + 4 * LANES
LEVEL, TURN2, BEND2, BEND3 = (LANES * i for i in range(4))
BENT = STRAIGHT + 8 * LANES

# Where they begin
PEAKS = 5 * INPUT
ALONE = PEAKS + 5 * LANES  # one set
APART = ALONE + 5 * STRAIGHT  # two with one between them
PAIRS = APART + 3 * STRAIGHT  # two neighbours
THREES = PAIRS + 4 * BENT  # three in a row
RULE_SIZE = THREES + 3 * BENT

# The width of a set that is a point: where nothing else is strong the centroid is the mean of the
# peaks, and beside any other area it is lost in rounding.
POINT_WIDTH = 1e-200
# Added to the area where no rule fires
NOTHING = 1e-300


@inlined
def highest(
    v0: float, slope0: float, v1: float, slope1: float
) -> tuple[float, float, float, float]:
    """The higher one of two lines: value at level 0, slope, next level, change of slope there."""
    if v1 > v0 or (v1 == v0 and slope1 > slope0):
        v0, slope0, v1, slope1 = v1, slope1, v0, slope0
    turn = slope1 - slope0
    if turn <= 0.0:
        return v0, slope0, 1.0, 0.0
    return v0, slope0, min(1.0, (v0 - v1) / turn), turn


@inlined
def meeting(right: Triangle, left: Triangle) -> float:
    """The level at which the right end of one set meets the left end of another, at most 1."""
    width = right[2] - left[0]
    closing = (right[2] - right[1]) + (left[1] - left[0])
    if width <= 0.0:
        return 0.0
    return 1.0 if width >= closing else width / closing


@inlined
def lay_term(
    rows: Array, at: int, sign: float, r0: Triangle, r1: Triangle, l0: Triangle, l1: Triangle
) -> None:
    """What lies left of two right ends and right of two left ends, times ``sign``.

    The moment is half the integral of right^2 - left^2 over the level.
    """
    v, slope, level, turn = highest(-r0[2], r0[2] - r0[1], -r1[2], r1[2] - r1[1])
    rv, rs = -v, -slope
    lv, ls, left_level, left_turn = highest(l0[0], l0[1] - l0[0], l1[0], l1[1] - l1[0])
    rows[at + END] = min(meeting(r0, l0), meeting(r0, l1), meeting(r1, l0), meeting(r1, l1))
    rows[at + AREA1] = sign * (rv - lv)
    rows[at + AREA2] = sign * (rs - ls) / 2.0
    rows[at + MOMENT1] = sign * (rv * rv - lv * lv) / 2.0
    rows[at + MOMENT2] = sign * (rv * rs - lv * ls) / 2.0
    rows[at + MOMENT3] = sign * (rs * rs - ls * ls) / 6.0
    if r0 != r1 or l0 != l1:
        lay_bend(rows, at + RIGHT, sign, rv, rs, level, -turn)
        lay_bend(rows, at + LEFT, -sign, lv, ls, left_level, left_turn)


@inlined
def lay_bend(
    rows: Array, at: int, sign: float, v: float, slope: float, level: float, turn: float
) -> None:
    """What a line's change of slope by ``turn`` adds in powers of the level above ``level``."""
    rows[at + LEVEL] = level
    rows[at + TURN2] = sign * turn / 2.0
    rows[at + BEND2] = sign * turn * (v + slope * level) / 2.0
    rows[at + BEND3] = sign * turn * (slope + turn / 2.0) / 3.0


@inlined
def lay_rules(rows: Array, k: Memberships) -> None:
    """All coefficients of memberships k1..k22, for the lane that ``rows`` begins with."""
    inputs, sets = fuzzy_sets(k).inputs, fuzzy_sets(k).output
    for j in range(5):
        a, b, c = inputs[j]
        at = j * INPUT
        rows[at + A], rows[at + B], rows[at + C] = a, b, c
        rows[at + RISE] = 1.0 / (b - a) if b > a else 0.0
        rows[at + FALL] = 1.0 / (c - b) if c > b else 0.0
        one = sets[j]
        rows[PEAKS + j * LANES] = one[1]
        lay_term(rows, ALONE + j * STRAIGHT, 1.0, one, one, one, one)
    for j in range(4):
        one, two = sets[j], sets[j + 1]
        lay_term(rows, PAIRS + j * BENT, -1.0, one, two, one, two)
    for j in range(3):
        one, two, three = sets[j], sets[j + 1], sets[j + 2]
        lay_term(rows, APART + j * STRAIGHT, -1.0, one, one, three, three)
        lay_term(rows, THREES + j * BENT, 1.0, one, two, two, three)


@inlined
def membership(rows: Array, at: int, x: float) -> float:
    """Of ``x`` in an input set; a vertical edge includes b."""
    rising = max(0.0, (x - rows[at + A]) * rows[at + RISE])
    falling = max(0.0, (rows[at + C] - x) * rows[at + FALL])
    rising = 1.0 if x >= rows[at + B] else rising
    falling = 1.0 if x <= rows[at + B] else falling
    return min(rising, falling)


@inlined
def five_memberships(rows: Array, at: int, x: float) -> Strengths:
    """Of ``x`` in the five input sets."""
    return (
        membership(rows, at, x),
        membership(rows, at + INPUT, x),
        membership(rows, at + 2 * INPUT, x),
        membership(rows, at + 3 * INPUT, x),
        membership(rows, at + 4 * INPUT, x),
    )


@inlined
def straight(rows: Array, at: int, h: float) -> tuple[float, float]:
    """Area and moment of a term up to the level ``h``."""
    t = min(h, rows[at + END])
    area = t * (rows[at + AREA1] + t * rows[at + AREA2])
    moment = t * (rows[at + MOMENT1] + t * (rows[at + MOMENT2] + t * rows[at + MOMENT3]))
    return area, moment


@inlined
def bent(rows: Array, at: int, h: float) -> tuple[float, float]:
    """The same where ends may change places."""
    area, moment = straight(rows, at, h)
    t = min(h, rows[at + END])
    r, l = at + RIGHT, at + LEFT
    x, y = max(0.0, t - rows[r + LEVEL]), max(0.0, t - rows[l + LEVEL])
    xx, yy = x * x, y * y
    area += xx * rows[r + TURN2] + yy * rows[l + TURN2]
    moment += xx * (rows[r + BEND2] + x * rows[r + BEND3])
    moment += yy * (rows[l + BEND2] + y * rows[l + BEND3])
    return area, moment


@inlined
def lane_gain(rows: Array, at: int, error: float, error_rate_1_s: float) -> float:
    """k_op of the lane that begins at ``at``, from e in [0, 1] and the rate of e in 1/s.

    As ``fuzzy.operating_gain``, but for strengths below 1e-100, which no step has.
    """
    e = five_memberships(rows, at, error)
    d = five_memberships(rows, at, min(abs(error_rate_1_s), 1.0))
    vs, s, m, large, vl = fire(e, d)
    h0, h1, h2, h3 = min(vs, s), min(s, m), min(m, large), min(large, vl)

    p = at + ALONE
    a0, m0 = straight(rows, p, vs)
    a1, m1 = straight(rows, p + STRAIGHT, s)
    a2, m2 = straight(rows, p + 2 * STRAIGHT, m)
    a3, m3 = straight(rows, p + 3 * STRAIGHT, large)
    a4, m4 = straight(rows, p + 4 * STRAIGHT, vl)
    area, moment = a0 + a1 + a2 + a3 + a4, m0 + m1 + m2 + m3 + m4
    p = at + APART
    a0, m0 = straight(rows, p, min(vs, m))
    a1, m1 = straight(rows, p + STRAIGHT, min(s, large))
    a2, m2 = straight(rows, p + 2 * STRAIGHT, min(m, vl))
    area, moment = area + (a0 + a1 + a2), moment + (m0 + m1 + m2)
    p = at + PAIRS
    a0, m0 = bent(rows, p, h0)
    a1, m1 = bent(rows, p + BENT, h1)
    a2, m2 = bent(rows, p + 2 * BENT, h2)
    a3, m3 = bent(rows, p + 3 * BENT, h3)
    area, moment = area + (a0 + a1 + a2 + a3), moment + (m0 + m1 + m2 + m3)
    p = at + THREES
    a0, m0 = bent(rows, p, min(h0, h1))
    a1, m1 = bent(rows, p + BENT, min(h1, h2))
    a2, m2 = bent(rows, p + 2 * BENT, min(h2, h3))
    area, moment = area + (a0 + a1 + a2), moment + (m0 + m1 + m2)

    p = at + PEAKS
    peaks = vs * rows[p] + s * rows[p + LANES] + m * rows[p + 2 * LANES]
    peaks += large * rows[p + 3 * LANES] + vl * rows[p + 4 * LANES]
    total = vs + s + m + large + vl
    centroid: float = (moment + POINT_WIDTH * peaks) / (area + POINT_WIDTH * total + NOTHING)
    return centroid
