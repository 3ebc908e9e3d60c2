"""The search space: bounds, and the order inside each triangle, kept by construction."""

from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.filter import memberships


class Space(NamedTuple):
    """D parameters by name, with bounds and the groups whose values ascend.

    ``chains`` holds the indices of each ascending group; the bounds of a group
    ascend too. A parameter marked ``logarithmic`` (bounds above 0) is searched
    by its logarithm, because a change by a factor means the same at any value.
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    chains: tuple[tuple[int, ...], ...] = ()
    logarithmic: tuple[bool, ...] = ()

    @property
    def dimensions(self) -> int:
        """The number of parameters, D."""
        return len(self.names)


def membership_space() -> Space:
    """k1..k22 within the paper's Eqs. (16) and (17), a <= b <= c inside each triangle."""
    return Space(
        names=memberships.NAMES,
        lower=memberships.LOWER,
        upper=memberships.UPPER,
        chains=tuple(chain for chain in memberships.CHAINS if len(chain) > 1),
        logarithmic=(False,) * len(memberships.NAMES),
    )


def join_spaces(*spaces: Space) -> Space:
    """The parameters of all spaces, one space after the other."""
    joined = Space((), (), ())
    for space in spaces:
        shift = joined.dimensions
        chains = tuple(tuple(shift + i for i in chain) for chain in space.chains)
        joined = Space(
            names=joined.names + space.names,
            lower=joined.lower + space.lower,
            upper=joined.upper + space.upper,
            chains=joined.chains + chains,
            logarithmic=joined.logarithmic + space.logarithmic,
        )
    return joined


def bounds(space: Space) -> tuple[Floats, Floats]:
    """Lower and upper bounds (D,) in search coordinates."""
    return encode(space, np.array(space.lower)), encode(space, np.array(space.upper))


def encode(space: Space, values: Floats) -> Floats:
    """Search coordinates of parameter values, (..., D)."""
    log = np.array(space.logarithmic, dtype=bool)
    out = np.array(values, dtype=np.float64)
    out[..., log] = np.log(out[..., log])
    return out


def decode(space: Space, positions: Floats) -> Floats:
    """Parameter values (N, D) of search coordinates (N, D); never outside the bounds."""
    log = np.array(space.logarithmic, dtype=bool)
    out = np.array(positions, dtype=np.float64)
    out[..., log] = np.exp(out[..., log])  # rounds, hence the clip
    return np.clip(out, space.lower, space.upper)


def make_feasible(space: Space, positions: Floats) -> Floats:
    """The feasible positions that any positions (N, D) stand for.

    Each coordinate is clipped to its bounds, then each chain is sorted. As a
    chain's lower bounds ascend, and its upper bounds too, sorting cannot leave
    them: the i-th smallest of some values is at least the i-th smallest of
    their lower bounds. A feasible position stays as it is, every feasible position
    can be reached, and a corner pushed past its neighbour takes the neighbour's place. Moving the
    corner onto its neighbour instead would pile the search up on vertical
    edges; rejecting it would waste evaluations where the space is narrow.
    """
    lower, upper = bounds(space)
    out = np.clip(positions, lower, upper)
    for chain in space.chains:
        columns = list(chain)
        out[:, columns] = np.sort(out[:, columns], axis=1)
    return out


def random_positions(space: Space, count: int, generator: np.random.Generator) -> Floats:
    """Feasible positions (count, D), uniform within the bounds before ordering."""
    lower, upper = bounds(space)
    drawn = lower + (upper - lower) * generator.random((count, space.dimensions))
    return make_feasible(space, drawn)
