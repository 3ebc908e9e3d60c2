"""The bees' phases, one by one, on a cost that is known."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest

from tuning.colony import Colony
from tuning.search import Search, SearchOptions
from tuning.space import Parameter

# A plain box: no chains, so that a candidate is exactly what the formula says.
BOX = tuple(Parameter(name, -5.0, 5.0, is_logarithmic=False) for name in "abc")


class Phase(NamedTuple):
    """The colony when it asks for the costs of candidates, and the cycles that have ended."""

    asked: Any
    positions: Any
    costs: Any
    failures: Any
    cycles: int

    @property
    def visited(self):
        """The source that each stands beside: all coordinates but one are the source's."""
        return np.array([np.argmax((self.positions == x).sum(axis=1)) for x in self.asked])


def sphere(x):
    return np.sum(x**2, axis=1)


def fail(x):
    """No candidate is better than anything."""
    return np.full(len(x), 1e9)


def flown(*answers, sources=10, limit=1000, seed=3, first=(), cycles=1):
    """Phases of a colony whose candidates cost what the answers say, the last again and again."""
    phases = []

    def evaluate(x):
        note(x)
        return answers[min(len(phases), len(answers)) - 1](x)

    def note(asked):
        state = (colony.positions, colony.costs, colony.failures)
        phases.append(Phase(asked, *(each.copy() for each in state), search.cycles))

    search = Search(BOX, SearchOptions("abc", sources, cycles, limit, seed), evaluate)
    colony = Colony(search, np.reshape(first, (-1, 3)), np.random.default_rng(seed))
    colony.fly()
    note(np.empty((0, 3)))
    return phases


def test_it_starts_where_it_is_asked_to_and_at_random_and_no_source_gets_worse():
    start, before, after, *_ = flown(sphere, first=(1.0, 2.0, 3.0))
    assert start.asked[0].tolist() == [1.0, 2.0, 3.0]
    assert len(np.unique(start.asked[:, 0])) == 10
    costs = sphere(before.asked)
    better = costs < before.costs
    assert 0 < better.sum() < len(better)
    assert np.array_equal(after.costs, np.minimum(before.costs, costs))
    assert np.array_equal(after.failures, np.where(better, 0, 1))


def test_each_bee_moves_one_coordinate_towards_or_away_from_another_source():
    """Never towards itself, by which it would stay; alpha fills [-1, 1]."""
    alphas = []
    for seed, sources in [*((seed, 3) for seed in range(200)), *((seed, 2) for seed in range(300))]:
        for phase in flown(sphere, fail, sources=sources, seed=seed)[1:3]:
            x, visited, asked = phase.positions, phase.visited, phase.asked
            at_bound = (np.abs(x[visited]) == 5.0).any(axis=1)
            changed = asked != x[visited]
            assert ((changed.sum(axis=1) == 1) | at_bound).all()
            for i, j in np.argwhere(changed):
                old = x[visited[i], j]
                assert abs(asked[i, j] - old) <= np.abs(old - x[:, j]).max()  # the farthest
                if sources == 2 and abs(asked[i, j]) < 5.0:
                    alphas.append((asked[i, j] - old) / (old - x[1 - visited[i], j]))
    assert -1.0 <= min(alphas) < -0.95
    assert 0.95 < max(alphas) <= 1.0


def test_onlookers_prefer_fit_sources_in_proportion():
    """P_i = (1/(1 + J_i)) / sum: J = 0 is drawn four times as often as J = 3."""
    counts = np.zeros(2)
    for seed in range(2000):
        onlookers = flown(lambda _: np.array([0.0, 3.0]), fail, sources=2, seed=seed)[2]
        counts += np.bincount(onlookers.visited, minlength=2)
    # 4000 draws at 0.8: three standard deviations are 0.019
    assert counts[0] / counts.sum() == pytest.approx(0.8, abs=0.019)


def test_of_two_onlookers_at_one_source_the_better_is_kept():
    answers = (sphere, fail, lambda _: np.array([-2.0, -1.0, 1e9]))
    tried = (flown(*answers, sources=3, seed=seed)[2:] for seed in range(50))
    onlookers, after = next(two for two in tried if two[0].visited[0] == two[0].visited[1])
    twice = onlookers.visited[0]
    assert after.costs[twice] == -2.0
    assert np.array_equal(after.positions[twice], onlookers.asked[0])


def test_a_scout_leaves_the_source_that_failed_more_often_than_the_limit():
    as_many = scouts = 0
    for limit in range(3, 15):
        phases = flown(sphere, lambda x: fail(x) * (1 + (len(x) == 1)), sources=4, limit=limit,
                       seed=limit, cycles=20)  # fmt: skip
        for before, phase in pairwise(phases[1:]):
            if len(before.asked) == 1:  # worse, and accepted all the same
                scouts += 1
                left = int(np.argmax(before.failures))
                assert before.failures[left] > limit
                assert (phase.costs[left], phase.failures[left]) == (2e9, 0)
                assert phase.cycles == before.cycles + 1
            elif phase.cycles > before.cycles:  # a cycle that has ended without a scout
                assert phase.failures.max() <= limit
                as_many += phase.failures.max() == limit
    assert min(as_many, scouts) > 3
