"""The paper's experiment: its figures, the search's costs beside its own, and other noise."""

from functools import partial

import msgspec
import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import simulate
from estimator.errors import InputError
from estimator.geometry.metrics import COST_SAMPLES
from estimator.geometry.rotations import unit
from estimator.profile import load_profile
from tests.paper_noise import NoiseScale, simulate_scaled
from tuning.paper_experiment import run_experiment
from tuning.space import decode, profile_with, random_positions
from tuning.task import PaperTask, midpoint_profile

SEEDS = (100, 101, 102)


def paper_task(groups=("membership",), base=None):
    return PaperTask(base or midpoint_profile(), groups, SEEDS, (200,))


def candidates(task, count):
    return decode(task.space, random_positions(task.space, count, np.random.default_rng(1)))


@pytest.mark.parametrize("groups", [("membership",), ("membership", "filter")])
@pytest.mark.parametrize(
    "confidence",
    [{}, {"gravity": 1.7, "magnetic": 2.5, "cross": 0.0}, {"gravity": 0.0}],
    ids=["the paper's", "beyond a plain step", "one vector"],
)
def test_agrees_with_the_experiment(groups, confidence):
    base = midpoint_profile()
    confidence = msgspec.structs.replace(base.confidence, **confidence)
    task = paper_task(groups, msgspec.structs.replace(base, confidence=confidence))
    values = candidates(task, 11)
    found = task.costs(values)
    for one, cost in zip(values, found, strict=True):
        profile = profile_with(task.space, task.base, one)
        experiments = [run_experiment(profile, seed).cost for seed in SEEDS]
        assert cost == pytest.approx(np.mean(experiments), rel=1e-9)
    assert np.ptp(found) > 1.0  # the candidates differ


def test_costs_are_the_same_bits_for_any_batch():
    task = paper_task()
    values = candidates(task, 19)
    alone = np.concatenate([task.costs(one[None, :]) for one in values])
    assert np.array_equal(task.costs(values), alone)


def test_refuses_a_base_that_is_not_the_papers_system():
    base = midpoint_profile()
    aligned = msgspec.structs.replace(base.filter, initial_attitude="align")
    for other, reported in (
        (msgspec.structs.replace(base, filter=aligned), "initial_attitude"),
        (load_profile("adaptive"), r"filter\.gain is 'noise'"),
        (load_profile("imu"), "raw vectors"),
    ):
        with pytest.raises(InputError, match=reported):
            paper_task(base=other)


def figures(profile, seeds, gain=None, signals=lambda _: None):
    """J, mean e over 4..14 s and the time in s to e < 0.01 of each seed, on its signals: (3, N)."""
    chosen = load_profile(profile)
    runs = [run_experiment(chosen, seed, gain, signals(seed)) for seed in seeds]
    return np.array([(r.cost, r.steady_state_error, r.settling_s) for r in runs]).T


# --- the paper's filter beside the figures of an independent prototype, over 40 seeds

PROTOTYPE_SEEDS = range(9_000, 9_040)
LEAST_SEEDS_ERROR = 0.07  # of the reference figures; taken as theirs, which makes the test stricter
# K: (mean J, mean e over 4..14 s, median time in s to e < 0.01)
FIGURES = {
    1: (49.0, 0.0187, 7.59),
    5: (32.7, 0.0040, 1.96),
    10: (19.5, 0.0040, 0.80),
    20: (12.0, 0.0041, 0.40),
    50: (8.1, 0.0045, 0.17),
    70: (7.7, 0.0050, 0.13),
    100: (8.1, 0.0059, 0.09),
}


@pytest.mark.parametrize("gain", FIGURES)
def test_fixed_gains_reproduce_the_reference_figures(gain):
    cost, steady, settling_s = FIGURES[gain]
    costs, errors, times_s = figures("paper", PROTOTYPE_SEEDS, gain)
    own_error = costs.std(ddof=1) / np.sqrt(len(costs))
    rounding = 0.05
    assert abs(costs.mean() - cost) < 3.0 * np.hypot(own_error, LEAST_SEEDS_ERROR) + rounding
    # printed with two digits: half of the last one, and the seeds' scatter
    scatter = 3.0 * np.sqrt(2.0 / len(errors)) * errors.std(ddof=1)
    assert abs(errors.mean() - steady) < 0.00005 + scatter
    assert np.median(times_s) == pytest.approx(settling_s, rel=0.1, abs=0.011)


def test_shipped_fuzzy_gain_beats_these_fixed_gains_within_the_papers_window():
    """After that K = 2 is steadier, and at other noise others are."""
    cost, steady, _ = figures("paper", PROTOTYPE_SEEDS).mean(axis=1)
    fixed = [figures("paper", PROTOTYPE_SEEDS, gain).mean(axis=1) for gain in FIGURES]
    best, steadiest, _ = np.min(fixed, axis=0)
    assert cost <= 0.85 * best
    assert steady < steadiest
    assert cost == pytest.approx(5.917, rel=0.01)  # the same numbers on every machine but for libm
    assert steady == pytest.approx(0.00350, rel=0.01)


# --- the gain that knows the noise, on noise that no number was chosen on

OTHER_SEEDS = range(9_100, 9_116)
FIXED = (2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 30.0)
VECTORS_X5 = partial(simulate_scaled, samples=COST_SAMPLES, scale=NoiseScale(vectors=5.0))
GYROSCOPE_X5 = partial(simulate_scaled, samples=COST_SAMPLES, scale=NoiseScale(gyroscope=5.0))


def with_outliers(seed):
    """The paper's signals, of which each vector is another one at random one time in twenty."""
    signals, rng = simulate(seed, COST_SAMPLES), np.random.default_rng(seed)
    columns = []
    for column in (signals.acc_m_s2, signals.mag_gauss):
        is_wrong = rng.random(len(column)) < 0.05
        wrong = unit(rng.normal(size=column.shape))
        wrong *= np.linalg.norm(column, axis=1, keepdims=True)
        columns.append(np.where(is_wrong[:, None], wrong, column))
    return signals._replace(acc_m_s2=columns[0], mag_gauss=columns[1])


def least_error(signals):
    """The mean e of the fixed gain that is best there in hindsight."""
    return min(figures("paper", OTHER_SEEDS, gain, signals)[1].mean() for gain in FIXED)


@pytest.mark.parametrize("signals", [VECTORS_X5, GYROSCOPE_X5], ids=["vectors", "gyroscope"])
def test_at_five_times_the_noise_it_is_steady_and_settles_as_soon_as_the_largest_gain(signals):
    _, errors, times_s = figures("adaptive", OTHER_SEEDS, None, signals)
    assert errors.mean() < 1.15 * least_error(signals)
    largest_s = figures("paper", OTHER_SEEDS, 100.0, signals)[2]
    assert np.median(times_s) <= 1.2 * np.median(largest_s)


def test_single_wrong_vectors_open_no_gain():
    _, errors, _ = figures("adaptive", OTHER_SEEDS, None, with_outliers)
    assert errors.mean() < 1.15 * least_error(with_outliers)


def test_it_costs_less_than_the_papers_whose_rules_suit_one_noise():
    ours, papers = (figures(name, OTHER_SEEDS).mean(axis=1) for name in ("adaptive", "paper"))
    assert ours[0] < 0.97 * papers[0]
    ours, papers = (
        figures(name, OTHER_SEEDS, None, VECTORS_X5).mean(axis=1) for name in ("adaptive", "paper")
    )
    assert papers[1] > 3.0 * ours[1]
