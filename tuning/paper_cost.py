"""The paper's cost of many candidates, by the live filter's own kernel."""

from typing import NamedTuple

import numpy as np

from drivers.simulation.simulated_vehicle import simulate
from estimator.arrays import Floats
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import types_of
from estimator.compilation.replacing import replacer
from estimator.filter.kernel import paper_arguments, run
from estimator.filter.memberships import Memberships
from estimator.filter.observation import ReferenceParams
from estimator.filter.types import FilterParams, FilterState
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, STEADY, TRANSIENT
from estimator.geometry.metrics import TRANSIENT_WEIGHT as WEIGHT
from estimator.geometry.quaternion import normalized_distance

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
    """The paper's signals with the noise of S seeds, (S, 1401, 3), and the truth (S, 1401, 4)."""

    gyr_rad_s: Floats
    acc_m_s2: Floats
    mag: Floats
    q_ned_frd: Floats


EXAMPLE = Signals(*(np.zeros((1, 1, 3)),) * 3, np.zeros((1, 1, 4)))


def paper_signals(seeds: tuple[int, ...]) -> Signals:
    """The signals up to the last sample that counts."""
    runs = [simulate(seed, COST_SAMPLES) for seed in seeds]
    names = ("gyr_rad_s", "acc_m_s2", "mag_gauss", "q_ned_frd")
    return Signals(*(np.array([getattr(r, n)[:SCORED_SAMPLES] for r in runs]) for n in names))


@inlined
def unpack(k: Floats) -> Memberships:
    """k1..k22 as the tuple that the fuzzy controller takes."""
    return (
        *(k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8], k[9], k[10]),
        *(k[11], k[12], k[13], k[14], k[15], k[16], k[17], k[18], k[19], k[20], k[21]),
    )


@compiled
def cost(base: Base, candidate: Floats, signals: Signals, seed: int) -> float:
    """J of Eq. (15), "Cost_function", of k1..k22, gamma, tau (24,) on one seed's signals."""
    params = tuned(base.params, unpack(candidate), candidate[GAMMA], candidate[TAU])
    gyr, acc, mag = signals.gyr_rad_s[seed], signals.acc_m_s2[seed], signals.mag[seed]
    estimates, _ = run(params, base.reference, base.start, gyr, acc, mag, DT_S)
    total = 0.0
    for k in range(len(estimates)):
        weight = WEIGHT if k < TRANSIENT_STOP else 1.0 if k >= STEADY_START else 0.0
        p, q = signals.q_ned_frd[seed, k], estimates[k]
        total += weight * normalized_distance((p[0], p[1], p[2], p[3]), (q[0], q[1], q[2], q[3]))
    return total


@compiled(types=lambda: types_of(Base(*paper_arguments()), np.zeros((1, 24)), EXAMPLE))
def costs(base: Base, candidates: Floats, signals: Signals) -> Floats:
    """J (C, S) of candidates (C, 24) on every seed."""
    found = np.empty((len(candidates), len(signals.mag)))
    for c in range(len(candidates)):
        for seed in range(len(signals.mag)):
            found[c, seed] = cost(base, candidates[c], signals, seed)
    return found
