"""What may set the paper's gain: the fuzzy controller by any table of rules, and simpler laws."""

from collections.abc import Callable

import numpy as np
from common.paper_filter import Law
from common.recordings import Array

from estimator.compilation.compiled import compiled
from estimator.filter.fuzzy import RULES, centroid, fuzzify
from estimator.filter.memberships import fuzzy_sets
from tuning.optimizers import run_search
from tuning.paper_cost import unpack
from tuning.search import Search, SearchOptions
from tuning.space import MEMBERSHIP, Parameter, Space, bounds

TABLE = np.array(RULES)
LARGEST = 124.0  # with a larger K a plain step of 10 ms would be too long


@compiled()
def fuzzy_gains(k, rules, error, rate):
    """k_op (C, S) of memberships (C, 22), by a table of 25 rules: min, max, centroid."""
    gains = np.empty(error.shape)
    for c in range(error.shape[0]):
        own = unpack(k.T, c)
        sets = fuzzy_sets(own).output
        for s in range(error.shape[1]):
            e = fuzzify(own, min(max(error[c, s], 0.0), 1.0))
            d = fuzzify(own, min(abs(rate[c, s]), 1.0))
            fired = np.zeros(5)
            for row in range(5):
                for column in range(5):
                    term = rules[row, column]
                    fired[term] = max(fired[term], min(d[row], e[column]))
            strengths = (fired[0], fired[1], fired[2], fired[3], fired[4])
            gains[c, s] = centroid(strengths, sets)
    return gains


def fuzzy(k: Array, rules: Array = TABLE) -> Law:
    """The paper's K = 1 + k_op with memberships (C, 22)."""
    k = np.ascontiguousarray(np.atleast_2d(k))
    return lambda e, d, _: 1.0 + fuzzy_gains(k, rules, e, d)


def fixed(gains: Array) -> Law:
    """One gain, of candidates (C, 1)."""
    return lambda e, _d, _t: 0.0 * e + gains


def hysteresis(values: Array) -> Law:
    """High from one error on, until it is below another; candidates (C, 4)."""
    low_gain, high_gain, off, on = values.T[:, :, None]
    high = np.array(True)

    def law(e: Array, _d: Array, _t: float) -> Array:
        nonlocal high
        high = np.where(high, e > off, e > np.maximum(off, on))
        return np.where(high, high_gain + 0.0 * e, low_gain)

    return law


def scales(names: str, lower: tuple[float, ...], upper: tuple[float, ...]) -> Space:
    """Parameters that are searched by their logarithm."""
    return tuple(map(Parameter, names.split(), lower, upper))


# What makes a law of candidates (C, D), and what is tuned of it.
KINDS: dict[str, tuple[Callable[[Array], Law], Space]] = {
    "fixed K": (fixed, scales("K", (0.5,), (LARGEST,))),
    "two levels with hysteresis": (
        hysteresis,
        scales("low high off on", (0.5, 20.0, 0.001, 0.01), (20.0, LARGEST, 0.2, 0.9)),
    ),
    "fuzzy, same budget": (fuzzy, MEMBERSHIP),
}


def tune(
    space: Space, evaluate: Callable[[Array], Array], food_sources: int, cycles: int
) -> tuple[Array, float]:
    """The values (D,) with the lowest cost that the bees find, and that cost."""
    options = SearchOptions("abc", food_sources, cycles, food_sources * len(space), 0)
    search = Search(space, options, evaluate)
    run_search(search, np.mean(bounds(space), axis=0))
    return search.best_values, search.best_cost
