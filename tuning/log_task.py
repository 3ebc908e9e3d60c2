"""Tuning on recorded flights: the whole estimator, aiding included, on what it got in flight.

The reference is the truth of a simulation, else the attitude that the whole log shows if that is
sure, else the autopilot's. A log with none is tuned on how well its own vectors are predicted.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.profile import Profile
from tuning.flight import Flight, Part
from tuning.flight_cost import FlightFigures, geometric_mean, measure
from tuning.parameters import CONDITIONED_GROUPS
from tuning.recovery import recovery_cost
from tuning.task import Scores, Task, profile_with, require_fuzzy_gain

# Below this rate the gyroscope is aliased, and the first second has only a handful of samples: they
# cannot show which memberships are better, as the paper's are made for 100 Hz.
MEMBERSHIP_RATE_HZ = 10.0
# Of one flight the later part is held out; of several every third, beginning with the second.
LATER_PART = 0.4
HELD_OUT_EVERY = 3
HELD_OUT_FIRST = 1


class Goal(NamedTuple):
    """What is minimised: the cost of a part, and how the costs of several become one."""

    cost: Callable[[Profile, Part], float]
    combine: Callable[[list[float]], float]
    unit: str


def _mean(costs: list[float]) -> float:
    return sum(costs) / len(costs)


GOALS = {
    # the errors that a user sees and the honesty of sigma, deg
    "flight": Goal(lambda profile, part: measure(profile, part).cost, geometric_mean, " deg"),
    "recovery": Goal(recovery_cost, _mean, ""),
    # how far coverage is from what it should be: all that shows of what moves sigma alone
    "coverage": Goal(lambda profile, part: measure(profile, part).miscoverage, _mean, ""),
}


def default_groups(goal: str, rate_hz: float) -> tuple[str, ...]:
    """The groups of parameters that a log of that rate can tune."""
    if goal != "recovery":
        return ("noise",) if goal == "flight" else ("sigma",)
    return ("membership",) if rate_hz >= MEMBERSHIP_RATE_HZ else ("confidence", "conditioning")


class Split(NamedTuple):
    """What is searched on, and what is held out."""

    tuning: tuple[Part, ...]
    held_out: tuple[Part, ...]


def split(flights: tuple[Flight, ...], held_out: frozenset[str] = frozenset()) -> Split:
    """Of several flights those named in ``held_out`` (SHA-256), or every third; of one the end."""
    if len(flights) == 1:
        flight = flights[0]
        n = len(flight.truth)
        cut = round((1.0 - LATER_PART) * n)
        return Split((Part(flight, 0, cut),), (Part(flight, cut, n),))
    chosen = held_out or {f.sha256 for f in flights[HELD_OUT_FIRST::HELD_OUT_EVERY]}
    parts = [Part(flight, 0, len(flight.truth)) for flight in flights]
    return Split(
        tuple(part for part in parts if part.flight.sha256 not in chosen),
        tuple(part for part in parts if part.flight.sha256 in chosen),
    )


@dataclass(frozen=True)
class LogTask(Task):
    """Tuning of ``groups`` on flights, some of which are held out.

    The search begins with ``base``; its result is judged beside ``judged_by``, if that is another.

    Raises:
        InputError: the base has no fuzzy gain whose memberships could be tuned; unknown groups.
    """

    split: Split
    goal: str = "flight"
    judged_by: Profile | None = None

    known_groups = CONDITIONED_GROUPS

    def __post_init__(self) -> None:
        if "k1" in self.space.names:
            require_fuzzy_gain(self.base)

    @property
    def before(self) -> Profile:
        """See :class:`Task`."""
        return self.judged_by or self.base

    def costs(self, values: Floats) -> Floats:
        """The goal's cost over the parts that are searched on."""
        found = (profile_with(self.space, self.base, row) for row in values)
        return np.array([self._cost(profile, self.split.tuning) for profile in found])

    def score(self, profile: Profile) -> Scores:
        """The cost over the tuning and over the held-out parts."""
        return Scores(*(self._cost(profile, parts) for parts in self.split))

    def held_out_figures(self, profile: Profile) -> list[tuple[str, FlightFigures]]:
        """What a user sees on each held-out part, by the flight's name."""
        return [(part.flight.name, measure(profile, part)) for part in self.split.held_out]

    def _cost(self, profile: Profile, parts: tuple[Part, ...]) -> float:
        goal = GOALS[self.goal]
        return goal.combine([goal.cost(profile, part) for part in parts])
