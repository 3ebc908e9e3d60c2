"""Tuning on the paper's signals: J of Eq. (15) "Cost_function", averaged over noise seeds."""

from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from estimator.arrays import Floats
from estimator.filter import memberships
from estimator.filter.types import initial_state
from estimator.profile import Profile, Provenance, load_profile
from estimator.types import IDENTITY
from tuning.objective import Scores, require_fuzzy_gain
from tuning.paper_cost import Base, Signals, costs, paper_signals
from tuning.paper_experiment import paper_settings, run_experiment
from tuning.parameters import RAW_GROUPS, space_of
from tuning.space import Space

# Noise seeds from here on are reserved for judging results; nothing may be tuned on them.
FIRST_RESERVED_SEED = 5000


def midpoint_profile() -> Profile:
    """The paper's profile with every k in the middle of its bounds: where ``sim:`` starts."""
    return msgspec.structs.replace(
        load_profile("paper"),
        membership=dict(zip(memberships.NAMES, memberships.midpoint(), strict=True)),
        provenance=Provenance(description="the middle of the paper's bounds"),
    )


@dataclass(frozen=True)
class PaperObjective:
    """Mean J over the prepared signals, of candidates that give k1..k22 and maybe gamma and tau.

    ``names`` are those of the candidates' columns; what they leave out is the base's.
    """

    names: tuple[str, ...]
    base: Base
    signals: Signals

    def costs(self, values: Floats) -> Floats:
        """See :class:`tuning.objective.Objective`."""
        found = costs(self.base, self._candidates(values), self.signals)
        # summed in their order: the same bits for any batch
        mean: Floats = np.cumsum(found, axis=1)[:, -1] / found.shape[1]
        return mean

    def _candidates(self, values: Floats) -> Floats:
        """Rows of k1..k22, gamma, tau as the kernel takes them."""
        columns = {name: values[:, i] for i, name in enumerate(self.names)}
        rest = np.ones(len(values))
        base = self.base.params
        gamma = columns.get("filter.gamma", base.gamma * rest)
        tau = columns.get("filter.rate_time_constant_s", base.rate_time_constant_s * rest)
        return np.stack([*(columns[name] for name in memberships.NAMES), gamma, tau], axis=1)


@dataclass(frozen=True)
class PaperTask:
    """The paper's optimisation: searched on ``noise_seeds``, scored on ``held_out_seeds``, too."""

    base: Profile
    groups: tuple[str, ...]
    noise_seeds: tuple[int, ...]
    held_out_seeds: tuple[int, ...]

    @cached_property
    def space(self) -> Space:
        """The parameters that are tuned."""
        return space_of(self.groups, RAW_GROUPS)

    @cached_property
    def objective(self) -> PaperObjective:
        """Mean J over the noise seeds."""
        settings = paper_settings(self.base)
        require_fuzzy_gain(self.base)
        base = Base(
            settings.filter, settings.reference, initial_state(settings.initial or IDENTITY)
        )
        return PaperObjective(self.space.names, base, paper_signals(self.noise_seeds))

    def score(self, profile: Profile) -> Scores:
        """Mean J over both kinds of seeds."""
        return Scores(
            _mean_cost(profile, self.noise_seeds), _mean_cost(profile, self.held_out_seeds)
        )


def _mean_cost(profile: Profile, seeds: tuple[int, ...]) -> float:
    return sum(run_experiment(profile, seed).cost for seed in seeds) / len(seeds)
