"""What a search minimises, and the profiles that its values stand for."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from math import cos, sin
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from estimator.arrays import Floats
from estimator.calibration import UNCHANGED, Calibration
from estimator.errors import InputError
from estimator.geometry.quaternion import rotate
from estimator.mounting import Mounting
from estimator.profile import Profile, parse_profile, profile_to_json, profile_to_toml
from tuning.parameters import COMPASS_TURN, space_of
from tuning.space import Space


class Scores(NamedTuple):
    """Mean costs by the live filter's kernels, on the data of the search and on held-out data."""

    cost: float
    held_out: float


@dataclass(frozen=True)
class Task(ABC):
    """Groups of parameters of a base profile, and data on which they are searched.

    ``batch`` is how many candidates one process best takes at a time.
    """

    base: Profile
    groups: tuple[str, ...]

    known_groups: ClassVar[dict[str, Space]]
    batch: ClassVar[int] = 1

    @property
    def before(self) -> Profile:
        """What the result is compared with."""
        return self.base

    @cached_property
    def space(self) -> Space:
        """The parameters that are tuned."""
        return space_of(self.groups, self.known_groups)

    @abstractmethod
    def costs(self, values: Floats) -> Floats:
        """Costs (C,) of parameter values (C, D), each with the same bits beside any others."""

    @abstractmethod
    def score(self, profile: Profile) -> Scores:
        """The costs of a profile, on what is searched on and on what is held out."""


def batches(task: Task, values: Floats) -> list[Floats]:
    """Candidates (C, D) as parts for processes."""
    return np.array_split(values, -(-len(values) // task.batch))


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
    tree["calibration"] = {COMPASS_TURN: 0.0}  # beside what the profile has
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
    turn_rad = changes.pop("calibration", {}).get(COMPASS_TURN, 0.0)
    if turn_rad != 0.0:
        base = msgspec.structs.replace(base, calibration=_compass_turned(base, turn_rad))
    sections = {name: _replace_keys(getattr(base, name), keys) for name, keys in changes.items()}
    return parse_profile(profile_to_toml(msgspec.structs.replace(base, **sections)), "tuned")


def _replace_keys(section: Any, keys: dict[str, float]) -> Any:
    if isinstance(section, dict):
        return {**section, **keys}
    return msgspec.structs.replace(section, **keys)


def _compass_turned(profile: Profile, turn_rad: float) -> Calibration:
    """The profile's calibration with the compass's readings turned about the body's down."""
    R, (c, s) = sensor_axes(profile.mounting), (cos(turn_rad), sin(turn_rad))
    turn = R.T @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ R
    matrix = (turn @ np.array(profile.calibration.mag_matrix)).round(6).tolist()
    return msgspec.structs.replace(profile.calibration, mag_matrix=tuple(map(tuple, matrix)))


def sensor_axes(mounting: Mounting) -> Floats:
    """The sensors' axes as columns (3, 3) in the body's."""
    return np.column_stack([rotate(mounting.q_frd_sensor, axis) for axis in UNCHANGED])


def _address(name: str) -> tuple[str, str]:
    """Section and key of the profile; k1..k22 have no section in their name."""
    section, _, key = name.rpartition(".")
    return section or "membership", key
