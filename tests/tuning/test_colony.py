"""The bees' phases, one by one, on a cost that is known."""

import numpy as np
import pytest

from estimator.filter.memberships import require_feasible
from tuning.colony import Colony
from tuning.space import Space, membership_space

# A plain box: no chains, so that a candidate is exactly what the formula says.
BOX = Space(tuple("abc"), (-5.0,) * 3, (5.0,) * 3, (), (False,) * 3)
NONE = np.empty((0, 3))


def sphere(x):
    return np.sum(x**2, axis=1)


def colony(sources=10, limit=1000, seed=3, space=BOX, first=NONE):
    return Colony(space, sources, limit, np.random.default_rng(seed), first)


def started(**options):
    bees = colony(**options)
    bees.tell(sphere(bees.ask()))
    return bees


def test_starts_at_the_given_position_and_at_random_ones():
    bees = colony(first=np.array([[1.0, 2.0, 3.0]]))
    asked = bees.ask()
    assert asked.shape == (10, 3)
    assert asked[0].tolist() == [1.0, 2.0, 3.0]
    assert len(np.unique(asked[:, 0])) == 10


def test_employed_bees_move_one_coordinate_towards_or_away_from_another_source():
    bees = started()
    x = bees.sources.positions
    asked = bees.ask()
    changed = asked != x
    assert (changed.sum(axis=1) == 1).all()  # with itself as the other source it would not move
    for i, j in np.argwhere(changed):
        reach = np.abs(x[i, j] - x[:, j]).max()  # |alpha| <= 1 times the farthest source
        assert abs(asked[i, j] - x[i, j]) <= reach


def test_no_bee_takes_its_own_source_for_the_other_one():
    """It would stay where it is: of any three sources, whoever is visited, employed or onlooker."""
    for seed in range(200):
        bees = started(sources=3, seed=seed)
        for _ in range(2):
            moved = (bees.ask() != bees.sources.positions[bees._visited]).any(axis=1)
            at_bound = (np.abs(bees.sources.positions[bees._visited]) == 5.0).any(axis=1)
            assert (moved | at_bound).all()
            bees.tell(np.full(3, 1e9))


def test_every_other_source_is_taken_equally_often():
    """Read off from a move along one coordinate, of sources that lie 1, 10 and 100 apart."""
    space = Space(("a",), (-1000.0,), (1000.0,), (), (False,))
    places = np.array([[0.0], [1.0], [11.0], [111.0]])
    far = 0
    for seed in range(600):
        bees = colony(sources=4, seed=seed, space=space, first=places)
        bees.tell(np.ones(4))
        far += abs(bees.ask()[3, 0] - 111.0) > 100.5  # only from the first two, with alpha near 1
    # alpha > 100.5/111 or 100.5/110, each of them taken once in three
    expected = 600 * ((1 - 100.5 / 111) + (1 - 100.5 / 110)) / 3
    assert abs(far - expected) < 4 * expected**0.5


def test_alpha_takes_both_signs_and_fills_its_interval():
    """With two sources k is the other one, so alpha can be read off."""
    alphas = []
    for seed in range(300):
        bees = started(sources=2, seed=seed)
        x = bees.sources.positions
        asked = bees.ask()
        for i in (0, 1):
            j = np.flatnonzero(asked[i] != x[i])
            if len(j) == 1 and abs(asked[i, j[0]]) < 5.0:  # not clipped to the box
                alphas.append((asked[i, j[0]] - x[i, j[0]]) / (x[i, j[0]] - x[1 - i, j[0]]))
    assert -1.0 <= min(alphas) < -0.95
    assert 0.95 < max(alphas) <= 1.0


def test_a_source_never_gets_worse_and_failures_are_counted():
    bees = started()
    before = bees.sources
    costs = sphere(bees.ask())
    bees.tell(costs)
    after = bees.sources
    better = costs < before.costs
    assert better.any()
    assert not better.all()
    assert np.array_equal(after.costs, np.minimum(before.costs, costs))
    assert np.array_equal(after.failures, np.where(better, 0, 1))


def test_onlookers_prefer_fit_sources_in_proportion():
    """P_i = (1/(1 + J_i)) / sum: J = 0 is drawn four times as often as J = 3."""
    bees = colony(sources=2)
    counts = np.zeros(2)
    for seed in range(2000):
        bees = colony(sources=2, seed=seed)
        bees.tell(np.array([0.0, 3.0]))
        bees.tell(np.array([9.0, 9.0]))  # no employed bee improves anything
        counts += np.bincount(bees._visited, minlength=2)
    # 4000 draws at 0.8: three standard deviations are 0.019
    assert counts[0] / counts.sum() == pytest.approx(0.8, abs=0.019)


def test_of_two_onlookers_at_one_source_the_better_is_kept():
    for seed in range(50):
        bees = started(sources=3, seed=seed)
        bees.tell(np.full(3, 1e9))
        visited = bees._visited.copy()
        if np.bincount(visited, minlength=3).max() < 2:
            continue
        asked = bees.ask().copy()
        twice = int(np.argmax(np.bincount(visited)))
        rounds = np.flatnonzero(visited == twice)
        costs = np.full(3, 1e9)
        costs[rounds[0]], costs[rounds[1]] = -2.0, -1.0
        bees.tell(costs)
        assert bees.sources.costs[twice] == -2.0
        assert np.array_equal(bees.sources.positions[twice], asked[rounds[0]])
        return
    pytest.fail("no source was drawn twice")


def test_one_scout_a_cycle_leaves_the_source_that_failed_most():
    bees = started(sources=4, limit=2)
    scouts_seen = 0
    for _ in range(40):
        if bees.is_scouting:
            assert bees.ask().shape == (1, 3)
            left = int(np.argmax(bees.sources.failures))
            assert bees.sources.failures[left] > 2
            cycle = bees.cycles
            bees.tell(np.array([123.0]))  # worse, and accepted all the same
            assert bees.sources.costs[left] == 123.0
            assert bees.sources.failures[left] == 0
            assert bees.cycles == cycle + 1
            scouts_seen += 1
        else:
            bees.tell(np.full(len(bees.ask()), 1e9))
    assert scouts_seen > 5
    assert bees.scouts >= scouts_seen


def test_a_source_may_fail_as_often_as_the_limit_says():
    """A scout flies after more failures than the limit, not after as many."""
    as_many = 0
    for limit in range(3, 15):
        bees = started(sources=4, limit=limit, seed=limit)
        for _ in range(2):
            while not bees.is_scouting:
                bees.tell(np.full(len(bees.ask()), 1e9))
                if bees._phase == "employed":  # a cycle ended without a scout
                    assert bees.sources.failures.max() <= limit
                    as_many += bees.sources.failures.max() == limit
            assert bees.sources.failures.max() > limit
            bees.tell(np.array([1e9]))
    assert as_many > 3


def test_no_scout_within_the_limit():
    bees = started(sources=4, limit=1000)
    for _ in range(40):
        assert not bees.is_scouting
        bees.tell(np.full(len(bees.ask()), 1e9))
    assert bees.cycles == 20


def test_what_is_asked_depends_on_seed_and_costs_only():
    one, two, other = started(seed=5), started(seed=5), started(seed=6)
    for _ in range(30):
        assert np.array_equal(one.ask(), two.ask())
        one.tell(sphere(one.ask()))
        two.tell(sphere(two.ask()))
    assert not np.array_equal(one.ask(), other.ask())


def test_asking_twice_asks_the_same():
    bees = started()
    assert np.array_equal(bees.ask(), bees.ask())


def test_every_candidate_over_the_memberships_is_feasible():
    space = membership_space()
    bees = Colony(space, 20, 3, np.random.default_rng(2), np.empty((0, 22)))
    draws = np.random.default_rng(7)
    for _ in range(100):
        for k in bees.ask():
            require_feasible(tuple(k.tolist()))
        bees.tell(draws.random(len(bees.ask())))
    assert bees.scouts > 0


def test_finds_the_bottom_of_a_bowl():
    bees = started(sources=20)
    while bees.cycles < 100:
        bees.tell(sphere(bees.ask()))
    assert bees.sources.costs.min() < 1e-6
