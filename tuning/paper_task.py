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
from tuning.paper_cost import LANES, Base, Signals, costs, paper_signals
from tuning.paper_experiment import paper_settings, run_experiment
from tuning.parameters import RAW_GROUPS
from tuning.task import Scores, Task, profile_with, require_fuzzy_gain

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
class PaperTask(Task):
    """The paper's optimisation: searched on ``noise_seeds``, scored on ``held_out_seeds``, too.

    Raises:
        InputError: the base conditions its vectors, has no R_hat(0) or no fuzzy gain.
    """

    noise_seeds: tuple[int, ...]
    held_out_seeds: tuple[int, ...]

    known_groups = RAW_GROUPS
    batch = LANES

    def __post_init__(self) -> None:
        paper_settings(self.base)
        require_fuzzy_gain(self.base)

    @cached_property
    def _signals(self) -> Signals:
        return paper_signals(self.noise_seeds)

    def costs(self, values: Floats) -> Floats:
        """Mean J over the noise seeds; of a base that ignores a vector, run by run."""
        if not min(self.base.confidence.gravity, self.base.confidence.magnetic) > 0.0:
            profiles = (profile_with(self.space, self.base, row) for row in values)
            return np.array([_mean_cost(profile, self.noise_seeds) for profile in profiles])
        chosen = paper_settings(self.base)
        base = Base(chosen.filter, chosen.reference, initial_state(chosen.initial or IDENTITY))
        found = costs(base, self._candidates(base, values), self._signals)
        # summed in their order: the same bits for any batch
        mean: Floats = np.cumsum(found, axis=1)[:, -1] / found.shape[1]
        return mean

    def score(self, profile: Profile) -> Scores:
        """Mean J over both kinds of seeds."""
        return Scores(*(_mean_cost(profile, s) for s in (self.noise_seeds, self.held_out_seeds)))

    def _candidates(self, base: Base, values: Floats) -> Floats:
        """Rows of k1..k22, gamma, tau as the kernel takes them; what is not tuned is the base's."""
        columns = {name: values[:, i] for i, name in enumerate(self.space.names)}
        rest = np.ones(len(values))
        gamma = columns.get("filter.gamma", base.params.gamma * rest)
        tau = columns.get("filter.rate_time_constant_s", base.params.rate_time_constant_s * rest)
        return np.stack([*(columns[name] for name in memberships.NAMES), gamma, tau], axis=1)


def _mean_cost(profile: Profile, seeds: tuple[int, ...]) -> float:
    return sum(run_experiment(profile, seed).cost for seed in seeds) / len(seeds)
