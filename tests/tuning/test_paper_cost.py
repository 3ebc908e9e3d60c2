"""The search's costs against those of the experiment, and its against SciPy."""

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.errors import InputError
from estimator.profile import load_profile
from tuning.paper_experiment import run_experiment
from tuning.space import decode, profile_with, random_positions
from tuning.task import PaperTask, midpoint_profile

SEEDS = (100, 101, 102)


def paper_task(groups=("membership",), base=None, seeds=SEEDS):
    return PaperTask(base or midpoint_profile(), groups, seeds, (200,))


def candidates(space, count, seed=1):
    return decode(space, random_positions(space, count, np.random.default_rng(seed)))


def experiments_cost(task, values):
    profile = profile_with(task.space, task.base, values)
    return sum(run_experiment(profile, seed).cost for seed in SEEDS) / len(SEEDS)


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
    values = candidates(task.space, 11)
    found = task.costs(values)
    np.testing.assert_allclose(found, [experiments_cost(task, one) for one in values], rtol=1e-9)
    assert np.ptp(found) > 1.0  # the candidates differ


def test_costs_are_the_same_bits_for_any_batch():
    task = paper_task()
    values = candidates(task.space, 19)
    together = task.costs(values)
    alone = np.concatenate([task.costs(one[None, :]) for one in values])
    assert np.array_equal(together, alone)


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


def test_its_figures_are_those_of_the_paper_and_of_scipy():
    """It starts next to the unstable equilibrium."""
    result = run_experiment(load_profile("paper"), seed=7)
    assert result.true_error[0] == pytest.approx(0.9997, abs=5e-5)
    truth = Rotation.from_quat(np.roll(result.truth, -1, axis=1))
    estimate = Rotation.from_quat(np.roll(result.estimates, -1, axis=1))
    angle = (truth.inv() * estimate).magnitude()
    np.testing.assert_allclose(result.true_error, np.sin(angle / 2.0) ** 2, atol=1e-12)
    t = np.arange(1501) * 0.01
    transient, steady = t <= 1.0 + 1e-9, (t >= 4.0 - 1e-9) & (t <= 14.0 + 1e-9)
    expected = 0.3 * result.true_error[transient].sum() + result.true_error[steady].sum()
    assert result.cost == pytest.approx(expected, rel=1e-12)
    first = next(k for k, e in enumerate(result.true_error) if e < 0.01)
    assert 0 < first < 1000
    assert result.settling_s == pytest.approx(0.01 * first)
    assert result.mean_gain == pytest.approx(result.gains.mean())
