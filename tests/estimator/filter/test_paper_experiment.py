"""The paper's experiment beside the figures of an independent prototype, means over 40 seeds."""

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.filter import kernel
from estimator.filter.types import FilterState
from estimator.geometry.metrics import COST_RATE_HZ, COST_SAMPLES, STEADY, paper_cost
from estimator.geometry.quaternion import normalized_distance
from estimator.live.settings import settings_of
from estimator.profile import load_profile

SEEDS = range(9_000, 9_040)
LEAST_SEEDS_ERROR = 0.07  # of the reference figures; taken as theirs, which makes the test stricter
# K: (J, mean e over 4..14 s, median time in s to e < 0.01)
FIGURES = {
    1: (49.0, 0.0187, 7.59),
    5: (32.7, 0.0040, 1.96),
    10: (19.5, 0.0040, 0.80),
    20: (12.0, 0.0041, 0.40),
    50: (8.1, 0.0045, 0.17),
    70: (7.7, 0.0050, 0.13),
    100: (8.1, 0.0059, 0.09),
}


@pytest.fixture(scope="module")
def signals():
    return [simulate(seed, COST_SAMPLES, COST_RATE_HZ) for seed in SEEDS]


def true_errors(signals, fixed_gain):
    """e at t = 0.01 k for each seed, before the correction of each sample."""
    chosen = settings_of(load_profile("paper"), fixed_gain)
    errors = []
    for one in signals:
        estimates, _ = kernel.run(
            chosen.filter,
            chosen.reference,
            FilterState(chosen.initial),
            one.gyr_rad_s,
            one.acc_m_s2,
            one.mag_gauss,
            1.0 / COST_RATE_HZ,
        )
        pairs = zip(one.q_ned_frd.tolist(), estimates.tolist(), strict=True)
        errors.append([normalized_distance(tuple(q), tuple(p)) for q, p in pairs])
    return np.array(errors)


@pytest.mark.parametrize("gain", FIGURES)
def test_fixed_gains_reproduce_the_reference_figures(signals, gain):
    cost, steady, settling_s = FIGURES[gain]
    e = true_errors(signals, gain)
    J = np.array([paper_cost(row) for row in e])
    own_error = J.std(ddof=1) / np.sqrt(len(J))
    rounding = 0.05
    assert abs(J.mean() - cost) < 3.0 * np.hypot(own_error, LEAST_SEEDS_ERROR) + rounding
    # printed with two digits: half of the last one, and the seeds' scatter
    steady_means = e[:, STEADY].mean(axis=1)
    scatter = 3.0 * np.sqrt(2.0 / len(J)) * steady_means.std(ddof=1)
    assert abs(steady_means.mean() - steady) < 0.00005 + scatter
    settled = np.array([np.argmax(row < 0.01) if (row < 0.01).any() else np.inf for row in e])
    assert np.median(settled) / COST_RATE_HZ == pytest.approx(settling_s, rel=0.1, abs=0.011)


def test_shipped_fuzzy_gain_beats_these_fixed_gains_within_the_papers_window(signals):
    """After that K = 2 is steadier, and at other noise others are."""
    fuzzy = true_errors(signals, None)
    best, steadiest = np.inf, np.inf
    for gain in FIGURES:
        e = true_errors(signals, gain)
        best = min(best, np.mean([paper_cost(row) for row in e]))
        steadiest = min(steadiest, e[:, STEADY].mean())
    cost = np.mean([paper_cost(row) for row in fuzzy])
    assert cost <= 0.85 * best
    assert fuzzy[:, STEADY].mean() < steadiest
    assert cost == pytest.approx(5.917, rel=0.01)  # the same numbers on every machine but for libm
    assert fuzzy[:, STEADY].mean() == pytest.approx(0.00350, rel=0.01)
