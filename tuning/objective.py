"""What a search minimises: the cost of candidates, on data that are prepared once."""

from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np

from estimator.arrays import Floats
from estimator.errors import InputError
from estimator.profile import Profile, parse_profile, profile_to_json, profile_to_toml
from tuning.space import Space


class Objective(Protocol):
    """The mean cost of candidates given as parameter values (C, D), in the space's order."""

    def costs(self, values: Floats) -> Floats:
        """Costs (C,), each with the same bits beside any others."""


def one_cost(objective: Objective, row: Floats) -> float:
    """The cost of one candidate (D,)."""
    return float(objective.costs(row[None, :])[0])


class Scores(NamedTuple):
    """Mean costs by the live filter's kernels, on the data of the search and on held-out data."""

    tuning: float
    held_out: float


def require_fuzzy_gain(profile: Profile) -> None:
    """Refuse a profile whose gain the search would not run.

    Raises:
        InputError: ``filter.gain`` is another than "fuzzy".
    """
    if profile.filter.gain != "fuzzy":
        raise InputError(
            f"base profile: filter.gain is '{profile.filter.gain}'; only 'fuzzy' is tuned"
        )


def values_of(space: Space, profile: Profile) -> Floats:
    """The profile's values (D,) of the space's parameters, clipped to their bounds."""
    tree = profile_to_json(profile)
    values = [float(tree[section][key]) for section, key in map(_address, space.names)]
    clipped: Floats = np.clip(values, space.lower, space.upper)
    return clipped


def profile_with(space: Space, base: Profile, values: Floats) -> Profile:
    """``base`` with the space's parameters replaced.

    Raises:
        InputError: the result is no valid profile.
    """
    changes: dict[str, dict[str, float]] = {}
    for name, value in zip(space.names, values.tolist(), strict=True):
        section, key = _address(name)
        changes.setdefault(section, {})[key] = value
    sections = {name: _replace_keys(getattr(base, name), keys) for name, keys in changes.items()}
    changed = msgspec.structs.replace(base, **sections)
    return parse_profile(profile_to_toml(changed), "tuned")


def _replace_keys(section: Any, keys: dict[str, float]) -> Any:
    if isinstance(section, dict):
        return {**section, **keys}
    return msgspec.structs.replace(section, **keys)


def _address(name: str) -> tuple[str, str]:
    """Section and key of the profile; k1..k22 have no section in their name."""
    section, _, key = name.rpartition(".")
    return section or "membership", key
