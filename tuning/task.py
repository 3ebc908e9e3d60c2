"""What a search minimises: J on the paper's signals, or the cost of recorded flights."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from estimator.errors import InputError
from estimator.filter import memberships
from estimator.profile import Profile, Provenance, load_profile
from estimator.types import Floats
from tuning.flight import Flight
from tuning.flight_cost import geometric_mean, measure
from tuning.paper_cost import LANES, costs, paper_signals
from tuning.paper_experiment import begun, paper_settings, run_experiment
from tuning.recovery import recovery_cost
from tuning.space import CONDITIONED_GROUPS, RAW_GROUPS, Space, profile_with, space_of

# Noise seeds from here on are reserved for judging results; nothing may be tuned on them.
FIRST_RESERVED_SEED = 5000
# Below this rate the gyroscope is aliased, and the first second has only a handful of samples: they
# cannot show which memberships are better, as the paper's are made for 100 Hz.
MEMBERSHIP_RATE_HZ = 10.0
# Of one flight the later part is held out; of several every third, beginning with the second.
LATER_PART = 0.4
HELD_OUT = slice(1, None, 3)


class Goal(NamedTuple):
    """What is minimised: the cost of a flight (or seed), and how those of several become one."""

    cost: Callable[[Profile, Any], float]
    combine: Callable[[list[float]], float] = lambda costs: sum(costs) / len(costs)
    unit: str = ""


GOALS = {
    # the errors that a user sees and the honesty of sigma, deg
    "flight": Goal(lambda profile, flight: measure(profile, flight).cost, geometric_mean, " deg"),
    "recovery": Goal(recovery_cost),
    # how far coverage is from what it should be: all that shows of what moves sigma alone
    "coverage": Goal(lambda profile, flight: measure(profile, flight).miscoverage),
}
# As the paper's kernel takes them.
PAPER_NUMBERS = (*memberships.NAMES, "filter.gamma", "filter.rate_time_constant_s")
PAPER_GOAL = Goal(lambda profile, seed: run_experiment(profile, seed).cost)


@dataclass(frozen=True)
class Task:
    """Groups of parameters of a base profile, flights to search on, and those held out.

    Raises:
        InputError: the base has no fuzzy gain whose memberships could be tuned; unknown groups.
    """

    base: Profile
    groups: tuple[str, ...]
    searched: tuple[Any, ...]
    held_out: tuple[Any, ...]
    goal: str = "flight"

    known_groups: ClassVar[dict[str, Space]] = CONDITIONED_GROUPS
    batch: ClassVar[int] = 1  # candidates that one process best takes at a time

    def __post_init__(self) -> None:
        gain = self.base.filter.gain
        if self.space and self.tunes_memberships and gain != "fuzzy":  # the groups first
            raise InputError(f"base profile: filter.gain is '{gain}'; only 'fuzzy' is tuned")

    @property
    def measured(self) -> Goal:
        """What the goal's name stands for."""
        return GOALS[self.goal]

    @cached_property
    def space(self) -> Space:
        """The parameters that are tuned."""
        return space_of(self.groups, self.known_groups)

    @property
    def tunes_memberships(self) -> bool:
        """Whether k1..k22 are among them."""
        return "membership" in self.groups

    def cost(self, profile: Profile, on: tuple[Any, ...]) -> float:
        """The cost of a profile on what is searched on, or on what is held out."""
        return self.measured.combine([self.measured.cost(profile, each) for each in on])

    def costs(self, values: Floats) -> Floats:
        """Costs (C,) of parameter values (C, D), the same bits in any batch."""
        profiles = (profile_with(self.space, self.base, row) for row in values)
        return np.array([self.cost(profile, self.searched) for profile in profiles])

    def batches(self, values: Floats) -> list[Floats]:
        """Candidates (C, D) as parts for processes."""
        return np.array_split(values, -(-len(values) // self.batch))

    def score(self, profile: Profile) -> dict[str, float]:
        """The costs of a profile on what is searched on, and on what is held out, as JSON."""
        parts = {"cost": self.searched, "held_out": self.held_out}
        return {name: self.cost(profile, on) for name, on in parts.items()}


@dataclass(frozen=True)
class PaperTask(Task):
    """The paper's optimisation: J of Eq. (15) "Cost_function", averaged over noise seeds.

    Raises:
        InputError: the base conditions its vectors, has no R_hat(0), or no fuzzy gain whose
            memberships could be tuned.
    """

    goal: str = "paper"

    measured = PAPER_GOAL
    known_groups = RAW_GROUPS
    batch = LANES

    def __post_init__(self) -> None:
        paper_settings(self.base)
        super().__post_init__()

    def costs(self, values: Floats) -> Floats:
        """See :class:`Task`; of a base that ignores a vector, run by run."""
        if not min(self.base.confidence.gravity, self.base.confidence.magnetic) > 0.0:
            return super().costs(values)
        params, reference, start = begun(paper_settings(self.base))
        untuned = [*self.base.k, params.gamma, params.rate_time_constant_s]
        candidates = np.tile(untuned, (len(values), 1))
        candidates[:, [PAPER_NUMBERS.index(parameter.name) for parameter in self.space]] = values
        found = costs(params, reference, start, candidates, paper_signals(self.searched))
        # summed in their order, whatever the batch
        return np.asarray(np.cumsum(found, axis=1)[:, -1] / found.shape[1])


def midpoint_profile() -> Profile:
    """The paper's profile with every k in the middle of its bounds: where ``sim:`` starts."""
    return msgspec.structs.replace(
        load_profile("paper"),
        membership=dict(zip(memberships.NAMES, memberships.midpoint(), strict=True)),
        provenance=Provenance(description="the middle of the paper's bounds"),
    )


def default_groups(goal: str, rate_hz: float) -> tuple[str, ...]:
    """The groups of parameters that a log of that rate can tune."""
    if goal != "recovery":
        return ("noise",) if goal == "flight" else ("sigma",)
    return ("membership",) if rate_hz >= MEMBERSHIP_RATE_HZ else ("confidence", "conditioning")


def split(
    flights: tuple[Flight, ...], held_out: frozenset[str] = frozenset()
) -> tuple[tuple[Flight, ...], tuple[Flight, ...]]:
    """What is searched on and what is held out.

    Of several flights those named in ``held_out`` (SHA-256), or every third; of one the end.
    """
    if len(flights) == 1:
        cut = round((1.0 - LATER_PART) * len(flights[0].truth))
        return (flights[0]._replace(last=cut),), (flights[0]._replace(first=cut),)
    chosen = held_out or {f.sha256 for f in flights[HELD_OUT]}
    searched = tuple(flight for flight in flights if flight.sha256 not in chosen)
    return searched, tuple(flight for flight in flights if flight.sha256 in chosen)
