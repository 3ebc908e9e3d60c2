"""Which candidates are tried on a window: the colony that is kept, or chance, its rival."""

from collections.abc import Callable

import numpy as np

from tuning.arrays import Array
from tuning.colony import Colony
from tuning.space import Space, decode, encode, random_positions

Evaluate = Callable[[Array], Array]  # factors (C, D) to costs (C,)
# Search in a space, from kept factors (M, D): what was tried, its costs, what to keep
Look = Callable[[Space, Array, Evaluate, np.random.Generator], tuple[Array, Array, Array]]

FOOD_SOURCES = 6
CYCLES = 2
EVALUATIONS = FOOD_SOURCES * (1 + 2 * CYCLES)


def colony_search(
    space: Space, kept: Array, evaluate: Evaluate, generator: np.random.Generator
) -> tuple[Array, Array, Array]:
    """The kept food sources, evaluated anew on what is there now, and two cycles from them."""
    colony = Colony(
        space,
        food_sources=FOOD_SOURCES,
        limit=FOOD_SOURCES * space.dimensions,
        generator=generator,
        first=encode(space, np.clip(kept, space.lower, space.upper)),
    )
    tried, costs = [], []
    while colony.cycles < CYCLES:
        factors = decode(space, colony.ask())
        found = evaluate(factors)
        tried.append(factors)
        costs.append(found)
        colony.tell(found)
    return np.concatenate(tried), np.concatenate(costs), decode(space, colony.sources.positions)


def random_look(
    space: Space, kept: Array, evaluate: Evaluate, generator: np.random.Generator
) -> tuple[Array, Array, Array]:
    """As many candidates, drawn evenly."""
    drawn = random_positions(space, EVALUATIONS - 1, generator)
    factors = np.concatenate([kept[:1].clip(space.lower, space.upper), decode(space, drawn)])
    return factors, evaluate(factors), kept
