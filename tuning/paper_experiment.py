"""The paper's experiment: one noise seed, 15 s at 100 Hz, e(R~) against the truth."""

from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import Recording, simulate
from estimator.errors import InputError
from estimator.filter import kernel
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, STEADY, paper_cost, writable
from estimator.geometry.quaternion import normalized_distance
from estimator.live.settings import Settings, settings_of
from estimator.profile import Profile
from estimator.types import Floats

SETTLED_ERROR = 0.01


class ExperimentResult(NamedTuple):
    """One seed's figures; ``settling_s`` is infinite if e never falls below 0.01."""

    cost: float
    steady_state_error: float
    settling_s: float
    mean_gain: float
    true_error: Floats  # e at t = 0.01 k, k = 0..1500
    estimates: Floats  # (1501, 4) q_ned_frd before each correction
    truth: Floats  # (1501, 4)
    gains: Floats  # K (1501,)


def begun(settings: Settings) -> tuple[FilterParams, ReferenceParams, FilterState]:
    """What a run of the filter begins with: its first attitude is the settings'."""
    return settings.filter, settings.reference, FilterState(settings.initial)


def filtered(settings: Settings, signals: Recording) -> tuple[Floats, Floats]:
    """The attitudes before each correction (N, 4) and K (N,)."""
    gyr, acc, mag = map(writable, (signals.gyr_rad_s, signals.acc_m_s2, signals.mag_gauss))
    return kernel.run(*begun(settings), gyr, acc, mag, 1.0 / COST_RATE_HZ)


def paper_settings(profile: Profile, fixed_gain: float | None = None) -> Settings:
    """The settings of a profile that is the paper's system.

    Raises:
        InputError: the profile conditions its vectors or has no R_hat(0), so it is not.
    """
    chosen = settings_of(profile, fixed_gain)
    if chosen.conditioned or chosen.aligns:
        raise InputError(
            "the paper's experiment needs a profile of raw vectors with an initial attitude "
            "(conditioning.enabled = false, filter.initial_attitude), such as --profile paper"
        )
    return chosen


def run_experiment(
    profile: Profile,
    seed: int,
    fixed_gain: float | None = None,
    signals: Recording | None = None,
) -> ExperimentResult:
    """Run the filter of ``profile`` on the paper's signals with the noise of ``seed``, or others.

    Raises:
        InputError: see :func:`paper_settings`.
    """
    chosen = paper_settings(profile, fixed_gain)
    if signals is None:
        signals = simulate(seed, COST_SAMPLES, COST_RATE_HZ)
    estimates, gains = filtered(chosen, signals)
    pairs = zip(signals.q_ned_frd.tolist(), estimates.tolist(), strict=True)
    e = np.array([normalized_distance(*pair) for pair in pairs])
    settled = np.flatnonzero(e < SETTLED_ERROR)
    return ExperimentResult(
        cost=paper_cost(e),
        steady_state_error=float(e[STEADY].mean()),
        settling_s=float(settled[0] / COST_RATE_HZ) if len(settled) else float("inf"),
        mean_gain=float(gains.mean()),
        true_error=e,
        estimates=estimates,
        truth=signals.q_ned_frd,
        gains=gains,
    )
