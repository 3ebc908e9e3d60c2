"""What a search minimises: the cost of candidates, on data that are prepared once."""

from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np

from estimator.errors import InputError
from estimator.profile import Profile, parse_profile, profile_to_json, profile_to_toml
from tuning.arrays import Array
from tuning.space import Space


class Objective(Protocol):
    """The mean cost of candidates given as parameter values (C, D), in the space's order.

    Both methods return the same bits: each run is computed by one thread, and
    the mean over the runs is taken in their order.
    """

    def costs(self, values: Array) -> Array:
        """Costs (C,), all runs in one compiled call over numba's threads."""

    def serial_costs(self, values: Array) -> Array:
        """Costs (C,) on the calling thread alone, for a worker among others."""


class Scores(NamedTuple):
    """Mean costs by the live filter's kernels, on the data of the search and on held-out data."""

    tuning: float
    held_out: float


class Task(Protocol):
    """All that a search needs to know about what it tunes."""

    @property
    def space(self) -> Space:
        """The parameters that are tuned."""

    @property
    def base(self) -> Profile:
        """The profile that everything else comes from."""

    @property
    def objective(self) -> Objective:
        """The cost that is minimised."""

    def score(self, profile: Profile) -> Scores:
        """How good a profile is, by the plain kernels."""


def require_fuzzy_gain(profile: Profile) -> None:
    """Refuse a profile whose gain the search would not run.

    Raises:
        InputError: ``filter.gain`` is another than "fuzzy".
    """
    if profile.filter.gain != "fuzzy":
        msg = f"base profile: filter.gain is '{profile.filter.gain}'; only 'fuzzy' is tuned"
        raise InputError(msg)


def mean_over_runs(costs: Array) -> Array:
    """Mean (C,) of (C, S), summed in the order of the runs: the same for any batch."""
    total = np.zeros(len(costs))
    for run in range(costs.shape[1]):
        total += costs[:, run]
    mean: Array = total / costs.shape[1]
    return mean


def values_of(space: Space, profile: Profile) -> Array:
    """The profile's values (D,) of the space's parameters, clipped to their bounds."""
    tree = {**profile.membership, **_dotted_values(profile)}
    values = [float(tree[name]) for name in space.names]
    clipped: Array = np.clip(values, space.lower, space.upper)
    return clipped


def profile_with(space: Space, base: Profile, values: Array) -> Profile:
    """``base`` with the space's parameters replaced.

    Raises:
        InputError: the result is no valid profile.
    """
    changes: dict[str, dict[str, float]] = {}
    for name, value in zip(space.names, values.tolist(), strict=True):
        section, _, key = name.rpartition(".")
        changes.setdefault(section or "membership", {})[key] = value
    sections = {name: _replace_keys(getattr(base, name), keys) for name, keys in changes.items()}
    changed = msgspec.structs.replace(base, **sections)
    return parse_profile(profile_to_toml(changed), "tuned")


def _replace_keys(section: Any, keys: dict[str, float]) -> Any:
    if isinstance(section, dict):
        return {**section, **keys}
    return msgspec.structs.replace(section, **keys)


def _dotted_values(profile: Profile) -> dict[str, float]:
    tree = profile_to_json(profile)
    return {
        f"{section}.{key}": value
        for section in ("filter", "confidence", "conditioning", "aiding")
        for key, value in tree[section].items()
    }
