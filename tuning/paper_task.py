"""Tuning on the paper's signals: J of Eq. (15) "Cost_function", averaged over noise seeds."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from estimator.arrays import Floats
from estimator.filter import memberships
from estimator.profile import Filter, Profile, Provenance, load_profile
from tuning.objective import Scores
from tuning.paper_experiment import run_experiment
from tuning.paper_signals import PaperSignals, paper_signals
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
    base: Filter
    signals: PaperSignals

    def costs(self, values: Floats) -> Floats:
        """See :class:`tuning.objective.Objective`."""
        from tuning.paper_kernel import parallel_costs

        return self._mean_costs(parallel_costs, values)

    def serial_costs(self, values: Floats) -> Floats:
        """See :class:`tuning.objective.Objective`."""
        from tuning.paper_kernel import serial_costs

        return self._mean_costs(serial_costs, values)

    def _mean_costs(self, kernel: Callable[..., Floats], values: Floats) -> Floats:
        """Mean J (C,) over the seeds, summed in their order: the same bits for any batch."""
        from tuning.paper_kernel import Common

        common = Common(self.base.bias_bound_rad_s, self.base.first_step_s)
        costs = kernel(common, self._candidates(values), self.signals.start, self.signals.steps)
        mean: Floats = np.cumsum(costs, axis=1)[:, -1] / costs.shape[1]
        return mean

    def _candidates(self, values: Floats) -> Floats:
        """Rows of k1..k22, gamma, tau as the kernel takes them."""
        columns = {name: values[:, i] for i, name in enumerate(self.names)}
        rest = np.ones(len(values))
        gamma = columns.get("filter.gamma", self.base.gamma * rest)
        tau = columns.get("filter.rate_time_constant_s", self.base.rate_time_constant_s * rest)
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
        signals = paper_signals(self.base, self.noise_seeds)
        return PaperObjective(self.space.names, self.base.filter, signals)

    def score(self, profile: Profile) -> Scores:
        """Mean J by the plain kernel."""
        return Scores(
            _mean_cost(profile, self.noise_seeds), _mean_cost(profile, self.held_out_seeds)
        )


def _mean_cost(profile: Profile, seeds: tuple[int, ...]) -> float:
    return sum(run_experiment(profile, seed).cost for seed in seeds) / len(seeds)
