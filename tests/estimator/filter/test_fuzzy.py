"""The compiled inference against exact arithmetic; tests/fuzzbee holds it to scikit-fuzzy."""

from fractions import Fraction
from itertools import combinations, pairwise, product
from math import inf, nextafter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.filter import fuzzy
from estimator.filter.memberships import LOWER, UPPER, fuzzy_sets, midpoint
from tests.vocabulary import floats, random_memberships

# Agreement asked of the two inferences, relative; outputs are 0..100.
RELATIVE = 1e-9


def replaced(k, **values):
    changed = list(k)
    for name, value in values.items():
        changed[int(name[1:]) - 1] = value
    return tuple(changed)


def exact_centroid(heights, sets):
    """Centroid of max_i min(h_i, triangle_i) in rational arithmetic: no rounding at all."""
    lines = []  # x0, x1, value at x0, slope
    for height, corners in zip(heights, sets, strict=True):
        if height > 0.0 and corners[0] < corners[2]:
            h, a, b, c = map(Fraction, (height, *corners))
            left, right = a + h * (b - a), c - h * (c - b)
            if left > a:
                lines.append((a, left, Fraction(0), h / (left - a)))
            if right > left:
                lines.append((left, right, h, Fraction(0)))
            if c > right:
                lines.append((right, c, h, -h / (c - right)))
    if not lines:
        total = sum(map(Fraction, heights))
        weighted = sum(Fraction(h) * Fraction(s[1]) for h, s in zip(heights, sets, strict=True))
        return weighted / total if total else Fraction(0)
    bends = {x for line in lines for x in line[:2]}
    for (x0, x1, y0, m), (u0, u1, w0, n) in combinations(lines, 2):
        if m != n:
            x = (w0 - y0 + m * x0 - n * u0) / (m - n)
            if max(x0, u0) <= x <= min(x1, u1):
                bends.add(x)
    area = moment = Fraction(0)
    for left, right in pairwise(sorted(bends)):
        here = [line for line in lines if line[0] <= left and right <= line[1]]
        if not here:
            continue
        middle = (left + right) / 2
        _, top = max((y0 + m * (middle - x0), i) for i, (x0, _, y0, m) in enumerate(here))
        x0, _, y0, m = here[top]
        p, q = y0 + m * (left - x0), y0 + m * (right - x0)
        area += (right - left) * (p + q) / 2
        moment += (right - left) * (left * (2 * p + q) + right * (p + 2 * q)) / 6
    return moment / area


def membership(x, corners):
    """Membership of a triangle, whose vertical edges belong to the peak."""
    x, a, b, c = map(Fraction, (x, *corners))
    if x == b:
        return Fraction(1)
    if a < x < b:
        return (x - a) / (b - a)
    return (c - x) / (c - b) if b < x < c else Fraction(0)


def exact_gain(k, error, rate):
    """Mamdani's inference by all 25 rules."""
    sets = fuzzy_sets(k)
    e = [membership(min(max(error, 0.0), 1.0), corners) for corners in sets.inputs]
    d = [membership(min(abs(rate), 1.0), corners) for corners in sets.inputs]
    strengths = [Fraction(0)] * 5
    for row, consequents in enumerate(fuzzy.RULES):
        for column, consequent in enumerate(consequents):
            strengths[consequent] = max(strengths[consequent], min(d[row], e[column]))
    return float(exact_centroid(strengths, sets.output))


def assert_same_gain(k, error, rate):
    ours, exact = fuzzy.fuzzy_gain(k, error, rate), exact_gain(k, error, rate)
    assert ours == pytest.approx(exact, rel=RELATIVE, abs=1e-300), (k, error, rate)


def assert_exact(heights, sets):
    ours = fuzzy.centroid(heights, sets)
    assert ours == pytest.approx(float(exact_centroid(heights, sets)), rel=RELATIVE, abs=1e-300)


def corner_inputs(k):
    """0, 1 and every input corner, each with the numbers just below and above."""
    points = {0.0, 1.0, *k[:11]}
    around = {y for x in points for y in (nextafter(x, -inf), x, nextafter(x, inf))}
    return sorted(x for x in around if 0.0 <= x <= 1.0)


def random_inputs(rng):
    """Uniform over [0, 1] or, every other time, over the lower part, where most sets lie."""
    return (rng.uniform(0.0, 1.0, 2) * (0.5 if rng.random() < 0.5 else 1.0)).tolist()


def draws(rng):
    """Memberships and inputs of every sort: k, e and its rate."""
    for _ in range(2_000):
        yield random_memberships(rng), *random_inputs(rng)
    for _ in range(500):  # vertical edges, points and shared corners abound
        k = random_memberships(rng, round_to=0.05)
        yield k, *random_inputs(rng)
        yield k, *rng.choice(corner_inputs(k), 2).tolist()
    for k in (midpoint(), random_memberships(rng)):
        for inputs in product(corner_inputs(k)[::2], corner_inputs(k)[1::2]):
            yield k, *inputs
    # the lower bounds hold vertical edges at 0, 0.1, 0.2, 20; the upper ones at 0.2, 20 and 50
    for k in (LOWER, UPPER):
        for inputs in product([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.6, 1.0], repeat=2):
            yield k, *inputs
        for _ in range(200):
            yield k, *random_inputs(rng)


def test_agrees_with_exact_arithmetic():
    for case in draws(np.random.default_rng(20)):
        assert_same_gain(*case)


@pytest.mark.parametrize("faint", [1e-9, 1e-12, 1e-15, 1e-17, 1e-30, 1e-300, 5e-324])
def test_agrees_where_the_only_rule_fires_faintly(faint):
    """k1 = k2 = 0: an input of 1e-15 fires S with 1e-14; the area is small, the centroid is not."""
    k = replaced(midpoint(), k1=0.0, k2=0.0, k3=0.1)
    assert 0.0 < max(fuzzy.fire(fuzzy.fuzzify(k, faint), fuzzy.fuzzify(k, faint))) <= 1e-7
    assert_same_gain(k, faint, faint)
    assert fuzzy.fuzzy_gain(k, faint, faint) > 10.0


@pytest.mark.parametrize("faint", [1e-9, 1e-15, 1e-100, 1e-300, 1e-320])
def test_exact_for_faint_strengths(faint):
    sets = fuzzy_sets(midpoint()).output
    for heights in product((0.0, faint, 3.0 * faint), repeat=5):
        assert_exact(heights, sets)
    for strong in range(5):
        heights = tuple(0.7 if i == strong else faint for i in range(5))
        assert_exact(heights, sets)


def test_exact_on_random_sets_and_strengths():
    rng = np.random.default_rng(24)
    for grid in (None, 0.05, 0.1):
        for _ in range(300):
            sets = fuzzy_sets(random_memberships(rng, grid)).output
            heights = rng.uniform(0.0, 1.0, 5) * (rng.random(5) < 0.7)
            if grid is not None:
                heights = np.round(heights, 1)  # equal strengths and crossings at knees
            assert_exact(tuple(heights.tolist()), sets)


def test_exact_where_three_edges_meet_in_one_point():
    """Rounding may put the meeting of the second and third edge before the first crossing."""
    rng = np.random.default_rng(25)
    for _ in range(500):
        x, y = rng.uniform(30.0, 60.0), rng.uniform(0.2, 0.6)
        rising = np.sort(rng.uniform(1.0, 25.0, 3))[::-1]
        # rising edges through (x, y): a = x - y w, b = a + w
        sets = tuple(
            (x - y * w, x - y * w + w, x - y * w + w + rng.uniform(0.0, 10.0)) for w in rising
        )
        falling = (0.0, 5.0, 10.0)
        assert_exact((1.0, 0.9, 1.0, 0.0, 0.3), (*sets, falling, falling))


@pytest.mark.parametrize("width", [1e-3, 1e-6, 1e-9, 1e-12])
def test_thin_sets_beside_wide_ones(width):
    """The thin set's weight is its area, so it fades out as it narrows."""
    wide = fuzzy_sets(midpoint()).output
    thin = (0.0, 0.0, width)
    for heights in ((1.0, 0.0, 0.5, 0.0, 0.0), (1.0, 1e-9, 0.0, 0.0, 0.0)):
        assert_exact(heights, (thin, *wide[1:]))
    assert_exact((0.6, 0.0, 0.0, 0.0, 0.0), (thin, *wide[1:]))


def test_point_sets_without_area_give_the_mean_of_the_peaks():
    k = replaced(midpoint(), k12=0.0, k13=20.0, k14=20.0, k15=20.0)
    sets = fuzzy_sets(k).output
    assert fuzzy.centroid((0.6, 0.0, 0.0, 0.0, 0.0), sets) == 0.0
    assert fuzzy.centroid((0.0, 0.3, 0.0, 0.0, 0.0), sets) == 20.0
    assert fuzzy.centroid((0.25, 0.75, 0.0, 0.0, 0.0), sets) == pytest.approx(15.0)
    # through the whole controller: e fires VS and S, the rate VS
    sloped = replaced(k, k1=0.15, k2=0.0, k3=0.1)
    assert_same_gain(sloped, 0.05, 0.0)
    assert 0.0 < fuzzy.fuzzy_gain(sloped, 0.05, 0.0) < 20.0


def test_a_point_set_beside_one_with_area_has_no_weight():
    k = replaced(midpoint(), k12=0.0)
    sets = fuzzy_sets(k).output
    alone = fuzzy.centroid((0.0, 0.2, 0.0, 0.0, 0.0), sets)
    assert fuzzy.centroid((1.0, 0.2, 0.0, 0.0, 0.0), sets) == pytest.approx(alone, rel=1e-12)
    assert_same_gain(k, 0.02, 0.11)
    # also where the other set fires with the smallest number there is
    faint = fuzzy.centroid((1.0, 5e-324, 0.0, 0.0, 0.0), sets)
    assert faint == pytest.approx(0.5 * (k[12] + k[14]), rel=1e-12)


def test_midpoint_by_hand():
    """e = 1 fires VL fully and the rate 0 fires VS fully: VL alone, a right triangle 55..100."""
    assert fuzzy.fuzzy_gain(midpoint(), 1.0, 0.0) == pytest.approx(55.0 + 45.0 * 2.0 / 3.0)
    # e = 0, rate 0: VS alone, a right triangle 0..7.5 that falls
    assert fuzzy.fuzzy_gain(midpoint(), 0.0, 0.0) == pytest.approx(2.5)


def test_rules_are_the_papers_table():
    """Table I as printed: columns e = VL..VS, rows from VL down to VS, its "V" read as L."""
    printed = """
        VL VL VL L L
        VL VL VL L M
        VL VL L  M M
        VL VL M  M S
        VL VL M  S VS
    """
    terms = ("VS", "S", "M", "L", "VL")
    rows = [[terms.index(each) for each in line.split()] for line in printed.strip().split("\n")]
    assert tuple(tuple(reversed(row)) for row in reversed(rows)) == fuzzy.RULES


@given(st.integers(0, 2**32 - 1), floats(-1.0, 2.0), floats(-5.0, 5.0))
def test_inputs_beyond_their_universe_count_as_its_ends(seed, error, rate):
    assert_same_gain(random_memberships(np.random.default_rng(seed)), error, rate)
