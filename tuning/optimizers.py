"""The algorithms, all on one budget: bees, CMA-ES, differential evolution, and chance.

Each begins with the base profile's values among its first candidates (CMA-ES:
as its first mean), and each asks for the same number of evaluations.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from estimator.errors import InputError
from estimator.types import Floats
from tuning.colony import Colony
from tuning.search import Search, SearchEnd
from tuning.space import bounds, random_positions

# Standard deviation of the first generation, as a share of the width of the bounds: from the
# middle it covers them all.
CMA_SIGMA = 0.3


def run_search(search: Search, first: Floats) -> bool:
    """Run the algorithm that the search's options name, from position ``first`` (D,), to the end.

    Returns whether it came to its end: the observer may have asked to stop.

    Raises:
        InputError: the record is not of this search.
    """
    generator = np.random.default_rng(search.options.seed)
    try:
        ALGORITHMS[search.options.algorithm].run(search, first, generator)
    except SearchEnd as end:
        return end.is_finished
    return True


def bees(search: Search, first: Floats, generator: np.random.Generator) -> Floats:
    """Artificial bee colony, from one position or some; its food sources at the end (N, D)."""
    colony = Colony(search, np.atleast_2d(first), generator)
    colony.fly()
    return colony.positions


def cma_es(search: Search, first: Floats, generator: np.random.Generator) -> None:
    """CMA-ES on the unit cube, restarted with twice the population whenever it has converged.

    Source: A. Auger and N. Hansen, "A restart CMA evolution strategy with
    increasing population size", IEEE CEC 2005; by the package ``cmaes``.
    """
    from cmaes import CMA

    lower, upper = bounds(search.space)
    cube = np.array([[0.0, 1.0]] * len(search.space))
    mean = (first - lower) / (upper - lower)
    population = 4 + int(3 * np.log(len(first)))  # the usual size
    while True:
        seed = int(generator.integers(2**32))
        strategy = CMA(mean, CMA_SIGMA, bounds=cube, seed=seed, population_size=population)
        while not strategy.should_stop():
            asked = np.array([strategy.ask() for _ in range(population)])
            costs = search.costs(lower + (upper - lower) * asked[: search.left])
            if len(costs) < population:
                return
            strategy.tell(list(zip(asked, costs.tolist(), strict=True)))
            search.end_cycle(costs)
        population *= 2
        mean = generator.random(len(search.space))


def differential_evolution(search: Search, first: Floats, generator: np.random.Generator) -> None:
    """SciPy's differential evolution with N members; a batch is a generation; no early stop."""
    from scipy import optimize

    lower, upper = bounds(search.space)
    members = search.options.food_sources
    start = np.concatenate([first[None, :], random_positions(search.space, members - 1, generator)])
    held_costs = np.full(members, np.inf)
    whole = {"updating": "deferred", "vectorized": True, "tol": 0.0, "atol": -1.0, "polish": False}
    whole |= {"init": start, "rng": generator, "maxiter": 2 * search.options.cycles}

    def costs_of_columns(x: Floats) -> Floats:
        costs = search.costs(np.ascontiguousarray(x.T))
        np.minimum(held_costs, costs, out=held_costs)
        generation = search.evaluations // members - 1  # the first batch is the start
        if generation > 0 and generation % 2 == 0:  # two cost as much as a bees' cycle
            search.end_cycle(held_costs)
        return costs

    try:
        optimize.differential_evolution(costs_of_columns, optimize.Bounds(lower, upper), **whole)
    except RuntimeError as error:
        if isinstance(error.__cause__, InputError):  # SciPy takes any ValueError for its own
            raise error.__cause__ from None
        raise


def random_search(search: Search, first: Floats, generator: np.random.Generator) -> None:
    """Positions drawn evenly within the bounds: what every search has to beat."""
    count = search.options.food_sources
    asked = np.concatenate([first[None, :], random_positions(search.space, count - 1, generator)])
    while True:
        search.end_cycle(search.costs(asked))
        asked = random_positions(search.space, 2 * count, generator)


class Algorithm(NamedTuple):
    """Its name, how many food sources it needs at least, and what runs it."""

    name: str
    fewest_sources: int
    run: Callable[[Search, Floats, np.random.Generator], object]


ALGORITHMS = {
    "abc": Algorithm("artificial bee colony", 2, bees),
    "cmaes": Algorithm("CMA-ES", 1, cma_es),
    # it mixes three other members with two more
    "de": Algorithm("differential evolution", 5, differential_evolution),
    "random": Algorithm("random search", 1, random_search),
}
