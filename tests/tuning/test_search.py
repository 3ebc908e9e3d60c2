"""A search goes on from its record as if it had never stopped; what its bees do."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.errors import InputError
from estimator.filter.memberships import require_feasible
from tuning.colony import Colony
from tuning.optimizers import ALGORITHMS, run_search
from tuning.search import Record, Search, SearchOptions
from tuning.space import (
    CONDITIONED_GROUPS,
    MEMBERSHIP,
    RAW_GROUPS,
    Parameter,
    bounds,
    decode,
    encode,
    make_feasible,
    random_positions,
    space_of,
)

LOWER, UPPER = bounds(MEMBERSHIP)
FIRST = 0.5 * (LOWER + UPPER)


@pytest.fixture(params=ALGORITHMS)
def options(request):
    if request.param == "cmaes":
        pytest.importorskip("cmaes")
    return SearchOptions(request.param, food_sources=8, cycles=12, limit=5, seed=4)


def bowl(values):
    """A bowl whose bottom is a quarter up the bounds."""
    return np.sum(((values - LOWER) / (UPPER - LOWER) - 0.25) ** 2, axis=1)


def searched(options, **more):
    search = Search(MEMBERSHIP, options, bowl, **more)
    run_search(search, FIRST)
    return search


def test_cma_es_that_has_converged_begins_again_with_twice_the_population():
    pytest.importorskip("cmaes")
    space = tuple(Parameter(name, -1.0, 1.0, is_logarithmic=False) for name in "ab")
    sizes = []

    def noted(values):
        sizes.append(len(values))
        return sphere(values)

    options = SearchOptions("cmaes", food_sources=40, cycles=60, limit=5, seed=4)
    run_search(Search(space, options, noted), np.array([0.5, -0.3]))
    assert sizes[0] == 4 + int(3 * np.log(2))
    assert list(dict.fromkeys(sizes[:-1])) == [sizes[0] * 2**k for k in range(len(set(sizes[:-1])))]
    assert 2 * sizes[0] in sizes


def test_every_cycle_is_noted_and_the_budget_spent_and_no_more(options):
    """8 (1 + 2 x 12) evaluations; the bees' scouts come on top and are few."""
    search = searched(options)
    assert search.best_cost == search.record.costs.min() < bowl(FIRST[None, :])[0]
    assert bowl(search.best_values[None, :])[0] == search.best_cost
    assert [each.cycles for each in search.history] == list(range(1, search.cycles + 1))
    for each in search.history:
        assert each.best_cost <= min(each.median_cost, each.mean_cost)
    assert search.history[-1].best_cost >= search.best_cost  # CMA-ES ends with a part of one
    assert options.budget == 200
    if options.algorithm == "abc":
        assert 200 < search.evaluations <= 212  # the small limit sends scouts
        assert search.cycles == 12
        assert searched(options._replace(limit=1000)).evaluations == 200
    else:
        assert search.evaluations == 200


@pytest.mark.parametrize("batches", [1, 2, 5, -1])
def test_interrupted_and_resumed_is_the_same(options, batches):
    """The last time at the last batch."""
    every, seen, computed = [], [], []
    whole = searched(options, observe=lambda _: every.append(1) or True)
    last = batches % (len(every) + 1)

    def observe(search):
        seen.append(search.evaluations)
        return len(seen) != last

    broken = Search(MEMBERSHIP, options, bowl, observe)
    assert not run_search(broken, FIRST)

    def counted(values):
        computed.append(len(values))
        return bowl(values)

    resumed = Search(MEMBERSHIP, options, counted, earlier=broken.record)
    assert run_search(resumed, FIRST)
    assert sum(computed) == whole.evaluations - broken.evaluations  # nothing computed twice
    assert np.array_equal(resumed.best_values, whole.best_values)
    assert resumed.record.asked_sha256 == whole.record.asked_sha256
    assert np.array_equal(resumed.record.costs, whole.record.costs)
    assert resumed.history == whole.history


def test_a_record_of_another_search_is_refused(options):
    other = Search(MEMBERSHIP, options._replace(seed=5), bowl, lambda s: s.evaluations < 60)
    assert not run_search(other, FIRST)
    of_half_a_batch = Record(np.ones(other.evaluations - 1), "0" * 64)
    for record in (other.record, of_half_a_batch):
        with pytest.raises(InputError, match="does not belong"):
            searched(options, earlier=record)


# --- whatever a search asks for becomes feasible, and stays what it was if it already is


@given(st.lists(st.floats(-300.0, 300.0), min_size=22, max_size=22))
def test_any_position_becomes_feasible_and_stays_so(x):
    k = make_feasible(MEMBERSHIP, np.array([x]))
    require_feasible(tuple(k[0].tolist()))
    assert np.array_equal(make_feasible(MEMBERSHIP, k), k)


def test_only_broken_chains_and_bounds_change():
    k = FIRST.copy()
    k[0] = -1.0  # below its bound
    k[1], k[2] = 0.15, 0.05  # in the wrong order
    expected = k.copy()
    expected[0], expected[1], expected[2] = 0.0, 0.05, 0.15
    assert np.array_equal(make_feasible(MEMBERSHIP, k[None, :])[0], expected)


def test_random_positions_are_feasible_beside_other_groups_and_fill_the_bounds():
    space = space_of(("filter", "membership"), RAW_GROUPS)
    drawn = decode(space, random_positions(space, 2000, np.random.default_rng(1)))[:, 2:]
    for k in drawn[:200]:
        require_feasible(tuple(k.tolist()))
    # 2000 draws leave at most a few percent of a range that is open all the way
    assert (np.ptp(drawn, axis=0) / (UPPER - LOWER)).min() > 0.8


def test_logarithmic_parameters_are_halved_in_the_middle():
    space = (Parameter("a", 0.1, 10.0), Parameter("b", -1.0, 3.0, is_logarithmic=False))
    middle = 0.5 * (encode(space, np.array([[0.1, -1.0]])) + encode(space, np.array([[10.0, 3.0]])))
    assert np.allclose(decode(space, middle), [[1.0, 1.0]], rtol=1e-15, atol=0)


@given(st.floats(-10.0, 10.0))
def test_decoded_values_never_leave_the_bounds(x):
    for space in (*RAW_GROUPS.values(), *CONDITIONED_GROUPS.values()):
        (values,) = decode(space, make_feasible(space, np.full((1, len(space)), x)))
        assert all(p.lower <= value <= p.upper for p, value in zip(space, values, strict=True))


# --- the bees' phases, one by one, on a cost that is known

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
