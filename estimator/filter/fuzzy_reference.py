"""The fuzzy gain controller as the textbook has it, on scikit-fuzzy's plain functions.

It defines the memberships; ``estimator/filter/fuzzy.py`` computes the same thing
fast. scikit-fuzzy integrates a sampled aggregate, exactly where the samples
hold every vertex and crossing, so the universe is built to hold them; a
vertical edge becomes two adjacent floats. A set that is a single point has no
area and stays out of the aggregate, where adjacent floats would lend it one.
"""

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.filter.fuzzy import RULES
from estimator.filter.memberships import Memberships, Triangle, fuzzy_sets

Array = NDArray[np.float64]


def input_membership(x: float, corners: Triangle) -> float:
    """Membership of one number, by scikit-fuzzy's ``trimf``."""
    from skfuzzy import trimf

    return float(trimf(np.array([x]), np.array(corners))[0])


def rule_strengths(k: Memberships, error: float, error_rate_1_s: float) -> list[float]:
    """Strength of each output set: the 25 rules of Table I one by one."""
    sets = fuzzy_sets(k).inputs
    e = [input_membership(min(max(error, 0.0), 1.0), corners) for corners in sets]
    d = [input_membership(min(abs(error_rate_1_s), 1.0), corners) for corners in sets]
    strengths = [0.0] * 5
    for row, consequents in enumerate(RULES):
        for column, consequent in enumerate(consequents):
            fired = float(np.fmin(d[row], e[column]))
            strengths[consequent] = float(np.fmax(strengths[consequent], fired))
    return strengths


def universe(strengths: list[float], sets: tuple[Triangle, ...]) -> Array:
    """Every point where the aggregate bends: corners, clipping knees and crossings."""
    bends: set[float] = set()
    edges: list[tuple[float, float, float, float]] = []  # x0, y0, x1, y1 of each straight piece
    for h, (a, b, c) in zip(strengths, sets, strict=True):
        if h <= 0.0 or a == c:
            continue
        knees = (a, a + h * (b - a), c - h * (c - b), c)
        bends.update(knees)
        edges += [
            (knees[0], 0.0, knees[1], h),
            (knees[1], h, knees[2], h),
            (knees[2], h, knees[3], 0.0),
        ]
    for (x0, y0, x1, y1), (u0, w0, u1, w1) in combinations(edges, 2):
        if x1 == x0 or u1 == u0:
            continue
        slope, other = (y1 - y0) / (x1 - x0), (w1 - w0) / (u1 - u0)
        if slope != other:
            x = (w0 - y0 + slope * x0 - other * u0) / (slope - other)
            if max(x0, u0) <= x <= min(x1, u1):
                bends.add(x)
    # A vertical edge needs a point on each side of it; elsewhere they do no harm.
    points = {y for x in bends for y in (np.nextafter(x, -np.inf), x, np.nextafter(x, np.inf))}
    return np.array(sorted(points))


def gain(k: Memberships, error: float, error_rate_1_s: float) -> float:
    """k_op in [0, 100]: the same contract as :func:`estimator.filter.fuzzy.fuzzy_gain`."""
    from skfuzzy import centroid, trimf

    sets = fuzzy_sets(k).output
    strengths = rule_strengths(k, error, error_rate_1_s)
    if not any(strengths):
        return 0.0
    areas = [(h, corners) for h, corners in zip(strengths, sets, strict=True) if h > 0.0]
    areas = [(h, corners) for h, corners in areas if corners[0] < corners[2]]
    if not areas:
        peaks = [corners[1] for corners in sets]
        return float(np.average(peaks, weights=strengths))
    x = universe(strengths, sets)
    aggregate: Any = np.zeros_like(x)
    for h, corners in areas:
        aggregate = np.fmax(aggregate, np.fmin(h, trimf(x, np.array(corners))))
    # scikit-fuzzy divides by at least 2e-16, so a faint aggregate is scaled to height 1 first
    return float(centroid(x, aggregate / aggregate.max()))
