"""The artificial bee colony as ask and tell.

The paper's Section III-A after D. Karaboga and B. Basturk, "On the performance
of artificial bee colony (ABC) algorithm", Applied Soft Computing 8 (2008), with
whole phases asked at once, so that they can be evaluated in parallel:

* Employed bees: one candidate a food source, made from the positions at the
  beginning of the phase.
* Onlookers: N sources drawn with replacement, by fitness, after all employed
  bees have answered; one candidate a draw, again from the positions at the
  beginning of the phase. The answers are taken in the order of the draws: a
  source drawn twice keeps the better of its candidates.
* Scout: at most one a cycle. The source that failed most often, if more than
  ``limit`` times, moves to a random position.

Every random number comes from one generator, drawn when a phase is asked, in
one order. The candidates therefore depend on the seed and on the costs alone,
and not on who computes the costs.
"""

from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats, Ints
from tuning.space import Space, make_feasible, random_positions


class Sources(NamedTuple):
    """The N food sources: positions (N, D), costs (N,), failures in a row (N,)."""

    positions: Floats
    costs: Floats
    failures: Ints


class Colony:
    """N food sources over a space, in cycles of employed bees, onlookers and scout.

    ``first`` (M, D), M <= N, are positions to begin with; the others are
    random. :meth:`ask` gives a batch of candidates (n, D), :meth:`tell` takes
    their costs (n,); they alternate.
    """

    def __init__(
        self,
        space: Space,
        food_sources: int,
        limit: int,
        generator: np.random.Generator,
        first: Floats,
    ) -> None:
        self._space = space
        self._limit = limit
        self._generator = generator
        fresh = random_positions(space, food_sources - len(first), generator)
        self._asked = np.concatenate([make_feasible(space, first), fresh])
        self._visited = np.arange(food_sources)
        self._phase = "start"
        self.cycles = 0
        self.scouts = 0
        self.sources = Sources(
            positions=self._asked,
            costs=np.full(food_sources, np.inf),
            failures=np.zeros(food_sources, dtype=np.int64),
        )

    def ask(self) -> Floats:
        """The candidates of the next phase, all feasible; the same until :meth:`tell`."""
        return self._asked

    def tell(self, costs: Floats) -> None:
        """Take the costs of what was asked, and begin the next phase."""
        self._take(costs)
        if self._phase == "employed":
            self._send_onlookers()
        elif self._phase == "onlookers" and self.sources.failures.max() > self._limit:
            self._send_scout()
        else:
            self.cycles += self._phase != "start"
            self._phase = "employed"
            self._visit(np.arange(len(self.sources.costs)))

    @property
    def is_scouting(self) -> bool:
        """Whether what is asked is a scout's position."""
        return self._phase == "scout"

    def _take(self, costs: Floats) -> None:
        """A better candidate replaces its source; a source that was not improved fails.

        The first positions and a scout's are taken whatever their cost.
        """
        is_new = self._phase in {"start", "scout"}
        now = self.sources
        positions, held, failures = now.positions.copy(), now.costs.copy(), now.failures.copy()
        for i, candidate, cost in zip(self._visited, self._asked, costs, strict=True):
            if is_new or cost < held[i]:
                positions[i], held[i], failures[i] = candidate, cost, 0
            else:
                failures[i] += 1
        self.sources = Sources(positions, held, failures)

    def _send_onlookers(self) -> None:
        """P_i = fitness_i / sum of fitness, Eq. (14) "ABC_Probability", with Karaboga's 1/(1 + J).

        The paper writes J_i itself, but J is a cost: the worst source would draw most onlookers.
        """
        self._phase = "onlookers"
        fitness = 1.0 / (1.0 + self.sources.costs)
        chance = np.cumsum(fitness) / np.sum(fitness)
        drawn = self._generator.random(len(fitness))
        # the last sum can round to just below 1
        self._visit(np.minimum(np.searchsorted(chance, drawn, side="right"), len(fitness) - 1))

    def _send_scout(self) -> None:
        self._phase = "scout"
        self.scouts += 1
        self._visited = np.array([int(np.argmax(self.sources.failures))])
        self._asked = random_positions(self._space, 1, self._generator)

    def _visit(self, visited: Ints) -> None:
        """x_ij + alpha (x_ij - x_kj), Eq. (13) "ABC_Position", in one coordinate j of each source.

        k is another source. alpha is drawn from [-1, 1] as by Karaboga; the paper's [0, 1] can
        only lead away from x_k.
        """
        x = self.sources.positions
        n, d = x.shape
        count = len(visited)
        j = self._generator.integers(d, size=count)
        k = (visited + self._generator.integers(1, n, size=count)) % n
        alpha = self._generator.uniform(-1.0, 1.0, size=count)
        asked = x[visited]
        old = asked[np.arange(count), j]
        asked[np.arange(count), j] = old + alpha * (old - x[k, j])
        self._visited = visited
        self._asked = make_feasible(self._space, asked)
