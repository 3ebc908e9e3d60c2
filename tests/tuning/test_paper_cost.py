"""The search's costs against those of the experiment, run by run."""

from functools import partial

import msgspec
import numpy as np
import pytest

from estimator.errors import InputError
from estimator.profile import load_profile
from tuning.child import Pool
from tuning.objective import one_cost, profile_with
from tuning.paper_experiment import run_experiment
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.space import membership_space, random_positions

SEEDS = (100, 101, 102)


def paper_task(groups=("membership",), base=None, seeds=SEEDS):
    return PaperTask(base or midpoint_profile(), groups, seeds, (200,))


def candidates(space, count, seed=1):
    from tuning.space import decode

    return decode(space, random_positions(space, count, np.random.default_rng(seed)))


def experiments_cost(task, values):
    profile = profile_with(task.space, task.base, values)
    return sum(run_experiment(profile, seed).cost for seed in task.noise_seeds) / len(
        task.noise_seeds
    )


def test_agrees_with_the_experiment():
    task = paper_task()
    values = candidates(task.space, 30)
    found = task.objective.costs(values)
    expected = [experiments_cost(task, one) for one in values]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert np.ptp(found) > 1.0  # the candidates differ


def test_agrees_with_the_experiment_where_gamma_and_tau_vary_too():
    task = paper_task(("membership", "filter"))
    values = candidates(task.space, 10)
    found = task.objective.costs(values)
    np.testing.assert_allclose(found, [experiments_cost(task, one) for one in values], rtol=1e-9)


@pytest.mark.parametrize(
    "confidence", [{"gravity": 1.7, "magnetic": 2.5, "cross": 0.0}, {"gravity": 0.0}]
)
def test_agrees_with_the_experiment_at_other_confidences(confidence):
    """Also where a plain step would overshoot: K lambda dt beyond the limit; and by one vector."""
    base = midpoint_profile()
    confidence = msgspec.structs.replace(base.confidence, **confidence)
    task = paper_task(base=msgspec.structs.replace(base, confidence=confidence))
    values = candidates(task.space, 10)
    found = task.objective.costs(values)
    np.testing.assert_allclose(found, [experiments_cost(task, one) for one in values], rtol=1e-9)


def test_score_is_the_experiments_cost():
    task = paper_task()
    score = task.score(task.base)
    middle = 0.5 * (np.array(membership_space().lower) + np.array(membership_space().upper))
    assert score.tuning == experiments_cost(task, middle)
    assert score.held_out == run_experiment(task.base, 200).cost


def test_costs_are_the_same_bits_for_any_batch_and_any_process():
    task = paper_task()
    values = candidates(task.space, 16)
    together = task.objective.costs(values)
    alone = np.concatenate([task.objective.costs(one[None, :]) for one in values])
    assert np.array_equal(together, alone)
    with Pool(partial(one_cost, task.objective), 2) as pool:
        assert np.array_equal(together, [*pool(values)])


def test_refuses_a_base_without_a_first_attitude():
    base = midpoint_profile()
    changed = msgspec.structs.replace(base.filter, initial_attitude="align")
    task = paper_task(base=msgspec.structs.replace(base, filter=changed))
    with pytest.raises(InputError, match="initial_attitude"):
        _ = task.objective


def test_refuses_a_base_whose_gain_it_does_not_run():
    with pytest.raises(InputError, match=r"filter\.gain is 'noise'"):
        _ = paper_task(base=load_profile("adaptive")).objective


def test_refuses_a_base_with_conditioning():
    with pytest.raises(InputError, match="raw vectors"):
        _ = paper_task(base=load_profile("imu")).objective
