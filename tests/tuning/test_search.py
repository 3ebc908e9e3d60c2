"""A search goes on from its record as if it had never stopped, whatever the algorithm."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.errors import InputError
from estimator.filter.memberships import require_feasible
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

    def sphere(values):
        sizes.append(len(values))
        return np.sum(values**2, axis=1)

    options = SearchOptions("cmaes", food_sources=40, cycles=60, limit=5, seed=4)
    run_search(Search(space, options, sphere), np.array([0.5, -0.3]))
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

anywhere = st.lists(st.floats(-300.0, 300.0), min_size=22, max_size=22)


@given(anywhere)
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
