"""The bees' phases, one by one, on a cost that is known."""

import numpy as np
import pytest

from tuning.colony import Colony
from tuning.space import Parameter

# A plain box: no chains, so that a candidate is exactly what the formula says.
BOX = tuple(Parameter(name, -5.0, 5.0, is_logarithmic=False) for name in "abc")
NONE = np.empty((0, 3))


class Bees(Colony):
    """One phase at a time: its candidates, and the source that each stands beside."""

    def __init__(self, space, sources, limit, seed, first=NONE):
        super().__init__(space, sources, limit, np.random.default_rng(seed), first)
        self._flight = self.fly()
        self.asked = next(self._flight)

    @property
    def visited(self):
        """All coordinates but one are a source's."""
        return np.array([np.argmax((self.positions == x).sum(axis=1)) for x in self.asked])

    def take(self, costs):
        self.asked = self._flight.send(costs)

    def fail(self):
        """No candidate is better than anything."""
        self.take(np.full(len(self.asked), 1e9))


def sphere(x):
    return np.sum(x**2, axis=1)


def started(sources=10, limit=1000, seed=3):
    bees = Bees(BOX, sources, limit, seed)
    bees.take(sphere(bees.asked))
    return bees


def test_starts_at_the_given_position_and_at_random_ones():
    bees = Bees(BOX, 10, 1000, 3, np.array([[1.0, 2.0, 3.0]]))
    assert bees.asked.shape == (10, 3)
    assert bees.asked[0].tolist() == [1.0, 2.0, 3.0]
    assert len(np.unique(bees.asked[:, 0])) == 10


def test_each_bee_moves_one_coordinate_towards_or_away_from_another_source():
    """Of any three sources, employed or onlooker: with itself as the other it would stay."""
    for seed in range(200):
        bees = started(sources=3, seed=seed)
        for _ in range(2):
            x, visited, asked = bees.positions, bees.visited, bees.asked
            at_bound = (np.abs(x[visited]) == 5.0).any(axis=1)
            changed = asked != x[visited]
            assert ((changed.sum(axis=1) == 1) | at_bound).all()
            for i, j in np.argwhere(changed):
                old = x[visited[i], j]
                reach = np.abs(old - x[:, j]).max()  # |alpha| <= 1 times the farthest source
                assert abs(asked[i, j] - old) <= reach
            bees.fail()


def test_alpha_takes_both_signs_and_fills_its_interval():
    """With two sources k is the other one, so alpha can be read off."""
    alphas = []
    for seed in range(300):
        bees = started(sources=2, seed=seed)
        x, asked = bees.positions, bees.asked
        for i in (0, 1):
            j = np.flatnonzero(asked[i] != x[i])
            if len(j) == 1 and abs(asked[i, j[0]]) < 5.0:  # not clipped to the box
                alphas.append((asked[i, j[0]] - x[i, j[0]]) / (x[i, j[0]] - x[1 - i, j[0]]))
    assert -1.0 <= min(alphas) < -0.95
    assert 0.95 < max(alphas) <= 1.0


def test_a_source_never_gets_worse_and_failures_are_counted():
    bees = started()
    before, costs = bees.costs.copy(), sphere(bees.asked)
    bees.take(costs)
    better = costs < before
    assert 0 < better.sum() < len(better)
    assert np.array_equal(bees.costs, np.minimum(before, costs))
    assert np.array_equal(bees.failures, np.where(better, 0, 1))


def test_onlookers_prefer_fit_sources_in_proportion():
    """P_i = (1/(1 + J_i)) / sum: J = 0 is drawn four times as often as J = 3."""
    counts = np.zeros(2)
    for seed in range(2000):
        bees = Bees(BOX, 2, 1000, seed)
        bees.take(np.array([0.0, 3.0]))
        bees.fail()
        counts += np.bincount(bees.visited, minlength=2)
    # 4000 draws at 0.8: three standard deviations are 0.019
    assert counts[0] / counts.sum() == pytest.approx(0.8, abs=0.019)


def test_of_two_onlookers_at_one_source_the_better_is_kept():
    bees = next(
        bees
        for bees in (started(sources=3, seed=seed) for seed in range(50))
        if bees.fail() or np.bincount(bees.visited, minlength=3).max() >= 2
    )
    twice = int(np.argmax(np.bincount(bees.visited)))
    rounds, costs = np.flatnonzero(bees.visited == twice), np.full(3, 1e9)
    costs[rounds[:2]] = -2.0, -1.0
    first = bees.asked[rounds[0]].copy()
    bees.take(costs)
    assert bees.costs[twice] == -2.0
    assert np.array_equal(bees.positions[twice], first)


def test_a_scout_leaves_the_source_that_failed_more_often_than_the_limit():
    as_many = 0
    for limit in range(3, 15):
        bees = started(sources=4, limit=limit, seed=limit)
        for _ in range(2):
            cycle = bees.cycles
            while not bees.is_scouting:
                bees.fail()
                if bees.cycles > cycle:  # one ended without a scout
                    cycle = bees.cycles
                    assert bees.failures.max() <= limit
                    as_many += bees.failures.max() == limit
            assert bees.asked.shape == (1, 3)
            left = int(np.argmax(bees.failures))
            assert bees.failures[left] > limit
            bees.take(np.array([2e9]))  # worse, and accepted all the same
            assert (bees.costs[left], bees.failures[left]) == (2e9, 0)
            assert bees.cycles == cycle + 1
    assert as_many > 3
