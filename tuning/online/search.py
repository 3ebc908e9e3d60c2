"""Which candidates are tried on a window, by the colony that is kept from one to the next."""

from collections.abc import Callable

import numpy as np

from estimator.arrays import Floats
from tuning.colony import Colony
from tuning.space import Space, decode, encode

Evaluate = Callable[[Floats], Floats]  # factors (C, D) to costs (C,)
# Search in a space, from kept factors (M, D): what was tried, its costs, what to keep
Look = Callable[[Space, Floats, Evaluate, np.random.Generator], tuple[Floats, Floats, Floats]]

FOOD_SOURCES = 6
CYCLES = 2


def colony_search(
    space: Space, kept: Floats, evaluate: Evaluate, generator: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Evaluate the kept food sources on the present window, and go on from them for two cycles."""
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
