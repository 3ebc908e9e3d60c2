"""The fuzzy gain controller, compiled: Mamdani inference with the exact centroid.

min for AND, max over rules and for aggregation, clipped triangles, and the centroid of the
piecewise-linear aggregate in closed form. Tests compare it with scikit-fuzzy, to 1e-9 relative.
Paper: Section III-B, Table I "FLC" (rules), Figs. 4 "FLC_Inp_MMF" and 5 "FLC_Out_MMF"
(memberships).
"""

import numpy as np

from estimator.compilation.compiled import compiled, inlined
from estimator.filter.memberships import Five, Memberships, Triangle, fuzzy_sets

# A smaller area is computed again with the strengths times FAINT_LIFT, as the smallest numbers lose
# their digits. The knees are at the corners either way.
FAINT_AREA = 1e-200
FAINT_LIFT = 1e100

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


@inlined
def triangle(x: float, a: float, b: float, c: float) -> float:
    """Triangular membership of ``x``; a == b or b == c is a vertical edge that includes b."""
    if x == b:
        return 1.0
    if a < x < b:
        return (x - a) / (b - a)
    if b < x < c:
        return (c - x) / (c - b)
    return 0.0


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
def clipped_line(x: float, h: float, corners: Triangle, middle: float) -> float:
    """Extend to ``x`` the straight piece that min(h, triangle) follows around ``middle``.

    This gives the one-sided limit that a vertical edge needs.
    """
    a, b, c = corners
    if middle <= a or middle >= c:
        return 0.0
    left_knee = a + h * (b - a)
    right_knee = c - h * (c - b)
    if middle < left_knee:
        return (x - a) / (b - a)
    if middle > right_knee:
        return (c - x) / (c - b)
    return h


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
    strong = 0
    last = 0
    for i in range(5):
        if strengths[i] > 0.0:
            strong += 1
            last = i
    if strong == 1:  # the usual case near the truth
        return single_centroid(strengths[last], sets[last])
    area, moment = area_and_moment(strengths, sets)
    if area < FAINT_AREA:
        vs, s, m, large, vl = strengths
        lifted = (
            min(1.0, FAINT_LIFT * vs),
            min(1.0, FAINT_LIFT * s),
            min(1.0, FAINT_LIFT * m),
            min(1.0, FAINT_LIFT * large),
            min(1.0, FAINT_LIFT * vl),
        )
        area, moment = area_and_moment(lifted, sets)
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
def area_and_moment(strengths: Strengths, sets: Five) -> tuple[float, float]:
    """Area and first moment of the aggregate for sets in any order.

    Between two neighbouring knees every clipped triangle is a straight line, so the aggregate is
    the upper envelope of at most five lines: walk from crossing to crossing and sum the trapezoids.
    """
    knees = np.empty(20)
    n = 0
    for i in range(5):
        h = strengths[i]
        if h > 0.0:
            a, b, c = sets[i]
            for x in (a, a + h * (b - a), c - h * (c - b), c):
                j = n
                while j > 0 and knees[j - 1] > x:
                    knees[j] = knees[j - 1]
                    j -= 1
                knees[j] = x
                n += 1
    area = 0.0
    moment = 0.0
    left_y = np.empty(5)
    right_y = np.empty(5)
    for interval in range(n - 1):
        x0 = knees[interval]
        x1 = knees[interval + 1]
        width = x1 - x0
        if width <= 0.0:
            continue
        middle = 0.5 * (x0 + x1)
        top = 0
        for i in range(5):
            if strengths[i] > 0.0:
                left_y[i] = clipped_line(x0, strengths[i], sets[i], middle)
                right_y[i] = clipped_line(x1, strengths[i], sets[i], middle)
            else:
                left_y[i] = 0.0
                right_y[i] = 0.0
            if left_y[i] > left_y[top] or (left_y[i] == left_y[top] and right_y[i] > right_y[top]):
                top = i
        t = 0.0  # how much of the interval is done, 0..1
        while t < 1.0:
            crossing = 1.0
            following = top
            rise = right_y[top] - left_y[top]
            for i in range(5):
                faster = right_y[i] - left_y[i] - rise
                if faster > 0.0 and right_y[i] > right_y[top]:
                    # where three lines meet, rounding may put the meeting before t
                    meeting = max(t, (left_y[top] - left_y[i]) / faster)
                    if meeting < crossing:
                        crossing = meeting
                        following = i
            xa = x0 + t * width
            xb = x0 + crossing * width
            ya = left_y[top] + t * rise
            yb = left_y[top] + crossing * rise
            area += 0.5 * (xb - xa) * (ya + yb)
            moment += (xb - xa) / 6.0 * (xa * (2.0 * ya + yb) + xb * (ya + 2.0 * yb))
            t = crossing
            top = following
    return area, moment


@inlined
def operating_gain(k: Memberships, error: float, error_rate_1_s: float) -> float:
    """k_op in [0, 100] from e in [0, 1] and |de/dt| (1/s, larger values count as 1).

    ``k`` are the memberships k1..k22. No rule fires: 0.
    """
    e = fuzzify(k, min(max(error, 0.0), 1.0))
    d = fuzzify(k, min(abs(error_rate_1_s), 1.0))
    return centroid(fire(e, d), fuzzy_sets(k).output)


@compiled
def fuzzy_gain(k: Memberships, error: float, error_rate_1_s: float) -> float:
    """:func:`operating_gain`, to be called from Python."""
    return operating_gain(k, error, error_rate_1_s)
