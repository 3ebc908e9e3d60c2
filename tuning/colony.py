"""The artificial bee colony, whose candidates a search evaluates.

The paper's Section III-A after D. Karaboga and B. Basturk, "On the performance of artificial bee
colony (ABC) algorithm", Applied Soft Computing 8 (2008). A cycle has employed bees (one candidate a
food source), then onlookers (N sources drawn with replacement, by fitness; one candidate a draw),
and at most one scout: the source that failed most often, if more than ``limit`` times, moves to a
random position. A whole phase is asked at once, so that it can be evaluated in parallel. Its random
numbers are drawn before, so that they do not depend on who computes the costs.
"""

import numpy as np

from estimator.types import Floats, Ints
from tuning.search import Search
from tuning.space import make_feasible, random_positions


class Colony:
    """N food sources of a search: positions (N, D), costs (N,), failures in a row (N,).

    ``first`` (M, D), M <= N, are positions to begin with; the others are random.
    """

    def __init__(self, search: Search, first: Floats, generator: np.random.Generator) -> None:
        self._search, self._generator = search, generator
        sources = search.options.food_sources
        fresh = random_positions(search.space, sources - len(first), generator)
        self.positions = np.concatenate([make_feasible(search.space, first), fresh])
        self.costs = np.full(sources, np.inf)
        self.failures = np.zeros(sources, dtype=np.int64)

    def fly(self) -> None:
        """Fly for the search's number of cycles; scouts come on top of the budget.

        The first positions and a scout's are taken whatever their cost.
        """
        search, everyone = self._search, np.arange(len(self.costs))
        self.costs[:] = search.costs(self.positions)
        candidates = self._beside(everyone)
        while search.cycles < search.options.cycles:
            self._take(everyone, candidates, search.costs(candidates))
            drawn = self._onlookers()
            candidates = self._beside(drawn)
            self._take(drawn, candidates, search.costs(candidates))
            if self.failures.max() > search.options.limit:
                worn = int(np.argmax(self.failures))
                scout = random_positions(search.space, 1, self._generator)
                self.costs[worn] = search.costs(scout, scouts=True)[0]
                self.positions[worn], self.failures[worn] = scout[0], 0
            candidates = self._beside(everyone)
            search.end_cycle(self.costs)

    def _take(self, visited: Ints, candidates: Floats, costs: Floats) -> None:
        """A better candidate replaces its source; a source that was not improved fails."""
        for i, candidate, cost in zip(visited, candidates, costs, strict=True):
            if cost < self.costs[i]:
                self.positions[i], self.costs[i], self.failures[i] = candidate, cost, 0
            else:
                self.failures[i] += 1

    def _onlookers(self) -> Ints:
        """P_i = fitness_i / sum of fitness, Eq. (14) "ABC_Probability", with Karaboga's 1/(1 + J).

        The paper writes J_i itself, but J is a cost: the worst source would draw most onlookers.
        """
        fitness = 1.0 / (1.0 + self.costs)
        chance = np.cumsum(fitness) / np.sum(fitness)
        drawn = self._generator.random(len(fitness))
        # the last sum can round to just below 1
        return np.minimum(np.searchsorted(chance, drawn, side="right"), len(fitness) - 1)

    def _beside(self, visited: Ints) -> Floats:
        """x_ij + alpha (x_ij - x_kj), Eq. (13) "ABC_Position", in one coordinate j of each source.

        k is another source. alpha is drawn from [-1, 1] as by Karaboga; the paper's [0, 1] can
        only lead away from x_k.
        """
        x = self.positions
        n, d = x.shape
        count = len(visited)
        j = self._generator.integers(d, size=count)
        k = (visited + self._generator.integers(1, n, size=count)) % n
        alpha = self._generator.uniform(-1.0, 1.0, size=count)
        found = x[visited]
        old = found[np.arange(count), j]
        found[np.arange(count), j] = old + alpha * (old - x[k, j])
        return make_feasible(self._search.space, found)
