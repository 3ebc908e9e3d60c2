"""The fuzzy gain controller, compiled: Mamdani inference with the exact centroid.

min for AND, max over rules and for aggregation, clipped triangles, and the centroid of the
piecewise-linear aggregate in closed form: areas of sets, less what they share. Tests compare it
with scikit-fuzzy, to 1e-9 relative. Paper: Section III-B, Table I "FLC" (rules), Figs. 4
"FLC_Inp_MMF" and 5 "FLC_Out_MMF" (memberships).
"""

import numpy as np

from estimator.compilation.compiled import compiled, inlined
from estimator.filter.memberships import Five, Memberships, Triangle, fuzzy_sets

# A smaller area is computed again with the strengths times FAINT_LIFT, as the smallest numbers lose
# their digits. The knees are at the corners either way.
FAINT_AREA = 1e-200
FAINT_LIFT = 1e100
TWELFTH = 1.0 / 12.0

# The paper's Table I, "FLC". Row: rate of change of the error; column: error; both
# VS, S, M, L, VL. (The table's "V" is a misprint for L.)
RULES = (
    (0, 1, 2, 4, 4),
    (1, 2, 2, 4, 4),
    (2, 2, 3, 4, 4),
    (2, 3, 4, 4, 4),
    (3, 3, 4, 4, 4),
)

Strengths = tuple[float, float, float, float, float]
Moments = tuple[float, float]


@inlined
def triangle(x: float, a: float, b: float, c: float) -> float:
    """Triangular membership of ``x``; a == b or b == c is a vertical edge that includes b."""
    if a < x < c:
        return (x - a) / (b - a) if x < b else (c - x) / (c - b)
    return 1.0 if x == b else 0.0


@inlined
def fuzzify(k: Memberships, x: float) -> Strengths:
    """Membership of ``x`` in [0, 1] in the five input sets."""
    vs, s, m, large, vl = fuzzy_sets(k).inputs
    return (
        triangle(x, *vs),
        triangle(x, *s),
        triangle(x, *m),
        triangle(x, *large),
        triangle(x, *vl),
    )


@inlined
def fire(e: Strengths, d: Strengths) -> Strengths:
    """Strength of each output set: the strongest of its rules, min(error, rate) each.

    The 25 rules of Table I, grouped by consequent. The max over columns that share a row and a
    consequent comes before the min, which is the same by distributivity.
    """
    e_vs, e_s, e_m, e_l, e_vl = e
    d_vs, d_s, d_m, d_l, d_vl = d
    e_large = max(e_l, e_vl)
    d_any = max(d_vs, d_s, d_m, d_l, d_vl)
    vs = min(e_vs, d_vs)
    s = max(min(e_s, d_vs), min(e_vs, d_s))
    m = max(min(e_m, max(d_vs, d_s)), min(e_s, max(d_s, d_m)), min(e_vs, max(d_m, d_l)))
    large = max(min(e_m, d_m), min(e_s, max(d_l, d_vl)), min(e_vs, d_vl))
    vl = max(min(e_large, d_any), min(e_m, max(d_l, d_vl)))
    return (vs, s, m, large, vl)


@inlined
def centroid(strengths: Strengths, sets: Five) -> float:
    """Centroid of max_i min(h_i, triangle_i), exact; 0 if no set has strength.

    A zero area (all strong sets are points; k12 = 0 is a likely optimum) gives the
    strength-weighted mean of the peaks. Any other area counts: an input just within an edge fires a
    rule with 1e-16.
    """
    total = strengths[0] + strengths[1] + strengths[2] + strengths[3] + strengths[4]
    if total <= 0.0:
        return 0.0
    vs, s, m, large, vl = strengths
    strong = int(vs > 0.0) + int(s > 0.0) + int(m > 0.0) + int(large > 0.0) + int(vl > 0.0)
    if strong == 1:  # the usual case near the truth
        for i in range(5):
            if strengths[i] > 0.0:
                return single_centroid(strengths[i], sets[i])
    area, moment = union(strengths, sets)
    if area < FAINT_AREA:
        lifted = (
            min(1.0, FAINT_LIFT * vs),
            min(1.0, FAINT_LIFT * s),
            min(1.0, FAINT_LIFT * m),
            min(1.0, FAINT_LIFT * large),
            min(1.0, FAINT_LIFT * vl),
        )
        area, moment = union(lifted, sets)
    if area > 0.0:
        return moment / area
    weighted = 0.0
    for i in range(5):
        weighted += strengths[i] * sets[i][1]
    return weighted / total


@inlined
def single_centroid(h: float, corners: Triangle) -> float:
    """Centroid of min(h, triangle), h > 0, from its lower and its upper edge; b for a point."""
    a, b, c = corners
    left1 = a + h * (b - a)
    right1 = c - h * (c - b)
    width0 = c - a
    width1 = right1 - left1
    if width0 <= 0.0:
        return b
    sum0 = a + c
    sum1 = left1 + right1
    moment = width0 * (2.0 * sum0 + sum1) + width1 * (sum0 + 2.0 * sum1)
    return moment / (6.0 * (width0 + width1))


@inlined
def union(strengths: Strengths, sets: Five) -> Moments:
    """Area and first moment of the aggregate: of each set, less what two share, and so on."""
    strong = 0
    for i in range(5):
        strong |= int(strengths[i] > 0.0) << i
    area, moment, some = 0.0, 0.0, strong
    while some > 0:
        part = shared(strengths, sets, some)
        area, moment = area + part[0], moment + part[1]
        some = (some - 1) & strong
    return area, moment


@inlined
def shared(strengths: Strengths, sets: Five, some: int) -> Moments:
    """Area and first moment of what some sets (bits) share; negative of an even number of sets.

    Level by level: edges are straight lines of strength between the levels where two of them meet.
    """
    sign, top, left0, right0 = -1.0, 1.0, -np.inf, np.inf
    for i in range(5):
        if some >> i & 1:
            a, b, c = sets[i]
            sign, top = -sign, min(top, strengths[i])
            left0, right0 = max(left0, a), min(right0, c)
    y0 = area = moment = 0.0
    while y0 < top and left0 < right0:
        y1 = next_level(sets, some, y0, top)
        left1, right1 = -np.inf, np.inf
        for i in range(5):
            if some >> i & 1:
                a, b, c = sets[i]
                left1, right1 = max(left1, a + y1 * (b - a)), min(right1, c - y1 * (c - b))
        if right1 < left1:  # they meet below: the top of what is shared
            share = (right0 - left0) / ((right0 - left0) + (left1 - right1))
            y1 = y0 + share * (y1 - y0)
            left1 = right1 = left0 + share * (left1 - left0)
        width0, width1 = right0 - left0, right1 - left1
        sum0, sum1 = left0 + right0, left1 + right1
        both = width0 * (2.0 * sum0 + sum1) + width1 * (sum0 + 2.0 * sum1)
        area += sign * 0.5 * (y1 - y0) * (width0 + width1)
        moment += sign * TWELFTH * (y1 - y0) * both
        y0, left0, right0 = y1, left1, right1
    return area, moment


@inlined
def next_level(sets: Five, some: int, y0: float, top: float) -> float:
    """The lowest level above ``y0`` where two left edges meet, or two right ones; or the top."""
    for i in range(4):
        for j in range(i + 1, 5):
            if some >> i & some >> j & 1:
                a1, b1, c1 = sets[i]
                a2, b2, c2 = sets[j]
                top = meeting(a2 - a1, (b1 - a1) - (b2 - a2), y0, top)
                top = meeting(c1 - c2, (c1 - b1) - (c2 - b2), y0, top)
    return top


@inlined
def meeting(apart: float, closing: float, y0: float, top: float) -> float:
    """Where what is ``apart`` at level 0, and closes by so much a level, meets; or the top."""
    if closing != 0.0:
        level = apart / closing
        if y0 < level < top:
            return level
    return top


@inlined
def operating_gain(k: Memberships, error: float, error_rate_1_s: float) -> float:
    """k_op in [0, 100] from e in [0, 1] and |de/dt| (1/s, larger values count as 1).

    ``k`` are the memberships k1..k22. No rule fires: 0.
    """
    e = fuzzify(k, min(max(error, 0.0), 1.0))
    d = fuzzify(k, min(abs(error_rate_1_s), 1.0))
    return centroid(fire(e, d), fuzzy_sets(k).output)


@compiled()
def fuzzy_gain(k: Memberships, error: float, error_rate_1_s: float) -> float:
    """:func:`operating_gain`, to be called from Python."""
    return operating_gain(k, error, error_rate_1_s)
