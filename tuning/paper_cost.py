"""The paper's cost of many candidates, by the live filter's own kernel."""

from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import simulate
from estimator.arrays import Floats
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import types_of
from estimator.compilation.replacing import replacer
from estimator.filter.kernel import correct, paper_arguments, propagate
from estimator.filter.memberships import Memberships
from estimator.filter.observation import ReferenceParams, weighted_vectors
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, STEADY, TRANSIENT
from estimator.geometry.metrics import TRANSIENT_WEIGHT as WEIGHT
from estimator.geometry.quaternion import normalized_distance
from estimator.geometry.rotations import unit

DT_S = 1.0 / COST_RATE_HZ
# J ends at t = 14 s, the signals at 15 s
SCORED_SAMPLES = STEADY.stop
TRANSIENT_STOP, STEADY_START = TRANSIENT.stop, STEADY.start
# Columns of a candidate: k1..k22, then these
GAMMA, TAU = 22, 23

tuned = replacer(FilterParams, "memberships", "gamma", "rate_time_constant_s")


class Base(NamedTuple):
    """What all candidates share."""

    params: FilterParams
    reference: ReferenceParams
    start: FilterState


class Signals(NamedTuple):
    """The paper's signals with the noise of S seeds, and the truth (S, 1401, 4).

    Rates, and the unit vectors of the readings of field and gravity: (S, 1401, 3).
    """

    gyr_rad_s: Floats
    magnetic: Floats
    gravity: Floats
    q_ned_frd: Floats


EXAMPLE = Signals(*(np.zeros((1, 1, 3)),) * 3, np.zeros((1, 1, 4)))


def paper_signals(seeds: tuple[int, ...]) -> Signals:
    """The signals up to the last sample that counts."""
    runs = [simulate(seed, COST_SAMPLES) for seed in seeds]
    gyr, mag, acc, q = (
        np.array([getattr(run, name)[:SCORED_SAMPLES] for run in runs])
        for name in ("gyr_rad_s", "mag_gauss", "acc_m_s2", "q_ned_frd")
    )
    return Signals(gyr, unit(mag), unit(-acc), q)


@inlined
def unpack(k: Floats) -> Memberships:
    """k1..k22 as the tuple that the fuzzy controller takes."""
    return (
        *(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10]),
        *(k[11], k[12], k[13], k[14], k[15], k[16], k[17], k[18], k[19], k[20], k[21]),
    )


@compiled(types=lambda: types_of(Base(*paper_arguments()), np.zeros((1, 24)), EXAMPLE))
def costs(base: Base, candidates: Floats, signals: Signals) -> Floats:
    """J (C, S) of Eq. (15), "Cost_function", of k1..k22, gamma, tau (C, 24) on every seed."""
    found = np.zeros((len(candidates), len(signals.gravity)))
    for c in range(len(candidates)):
        k = candidates[c]
        params = tuned(base.params, unpack(k), k[GAMMA], k[TAU])
        for seed in range(len(signals.gravity)):
            found[c, seed] = _cost(base, params, signals, seed)
    return found


@inlined
def _cost(base: Base, params: FilterParams, signals: Signals, seed: int) -> float:
    """The live filter on one seed; e is taken before each correction."""
    total, state, step_s = 0.0, base.start, params.first_step_s
    for k in range(SCORED_SAMPLES):
        if k > 0:
            step_s, rate = DT_S, signals.gyr_rad_s[seed, k]
            state = propagate(state, (rate[0], rate[1], rate[2]), DT_S)
        weight = WEIGHT if k < TRANSIENT_STOP else 1.0 if k >= STEADY_START else 0.0
        q, m, g = signals.q_ned_frd[seed, k], signals.magnetic[seed, k], signals.gravity[seed, k]
        total += weight * normalized_distance((q[0], q[1], q[2], q[3]), state.q_ned_frd)
        field, down = (m[0], m[1], m[2]), (g[0], g[1], g[2])
        vectors = weighted_vectors(base.reference, field, 1.0, down, 1.0, 1.0)
        state = correct(params, state, vectors, step_s)
    return total
