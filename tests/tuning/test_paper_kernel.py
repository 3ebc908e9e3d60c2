"""The search's quick form of the paper's cost against the plain kernel's."""

import msgspec
import numba
import numpy as np
import pytest

from estimator.errors import InputError
from estimator.geometry.quaternion import exp
from estimator.profile import load_profile
from tuning.objective import profile_with
from tuning.paper_experiment import run_experiment
from tuning.paper_kernel import cosine, half_sine
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.space import membership_space, random_positions

SEEDS = (100, 101, 102)


def paper_task(groups=("membership",), base=None, seeds=SEEDS):
    return PaperTask(base or midpoint_profile(), groups, seeds, (200,))


def candidates(space, count, seed=1):
    from tuning.space import decode

    return decode(space, random_positions(space, count, np.random.default_rng(seed)))


def plain_cost(task, values):
    profile = profile_with(task.space, task.base, values)
    return sum(run_experiment(profile, seed).cost for seed in task.noise_seeds) / len(
        task.noise_seeds
    )


def test_agrees_with_the_plain_kernel():
    task = paper_task()
    values = candidates(task.space, 30)
    quick = task.objective.costs(values)
    plain = [plain_cost(task, one) for one in values]
    np.testing.assert_allclose(quick, plain, rtol=1e-9)
    assert np.ptp(quick) > 1.0  # the candidates differ


def test_agrees_with_the_plain_kernel_where_gamma_and_tau_vary_too():
    task = paper_task(("membership", "filter"))
    values = candidates(task.space, 10)
    quick = task.objective.costs(values)
    np.testing.assert_allclose(quick, [plain_cost(task, one) for one in values], rtol=1e-9)


def test_agrees_with_the_plain_kernel_at_other_confidences():
    """Also where a plain step would overshoot: K lambda dt beyond the limit."""
    base = midpoint_profile()
    confidence = msgspec.structs.replace(base.confidence, gravity=1.7, magnetic=2.5, cross=0.0)
    task = paper_task(base=msgspec.structs.replace(base, confidence=confidence))
    values = candidates(task.space, 10)
    quick = task.objective.costs(values)
    np.testing.assert_allclose(quick, [plain_cost(task, one) for one in values], rtol=1e-9)


def test_score_is_the_plain_cost():
    task = paper_task()
    score = task.score(task.base)
    middle = 0.5 * (np.array(membership_space().lower) + np.array(membership_space().upper))
    assert score.tuning == plain_cost(task, middle)
    assert score.held_out == run_experiment(task.base, 200).cost


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="needs compiled threads")
def test_costs_are_the_same_bits_for_any_batch_and_any_threads():
    task = paper_task()
    values = candidates(task.space, 16)
    together = task.objective.costs(values)
    alone = np.concatenate([task.objective.costs(one[None, :]) for one in values])
    assert np.array_equal(together, alone)
    assert np.array_equal(together, task.objective.serial_costs(values))
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        assert np.array_equal(together, task.objective.costs(values))
    finally:
        numba.set_num_threads(before)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-6, 0.02, 0.5, 1.0, 2.0, 2.4])
def test_series_of_the_exponential(angle_rad):
    """Up to the largest turn of a step."""
    axis = np.array([2.0, -1.0, 0.5])
    phi = angle_rad * axis / np.linalg.norm(axis)
    x = 0.25 * angle_rad * angle_rad
    series = (cosine(x), *(half_sine(x) * phi))
    np.testing.assert_allclose(series, exp(tuple(phi.tolist())), rtol=0, atol=5e-16)


@pytest.mark.parametrize(
    ("section", "change", "told"),
    [
        ("filter", {"initial_attitude": "align"}, "initial_attitude"),
        ("filter", {"euler_step_max_s": 0.001}, "euler_step_max_s"),
        ("confidence", {"gravity": 0.0}, "confidence.gravity"),
        ("reference", {"magnetic": (0.0, 0.0, 1.0)}, "collinear"),
    ],
)
def test_refuses_a_base_that_is_not_the_papers_system(section, change, told):
    base = midpoint_profile()
    changed = msgspec.structs.replace(getattr(base, section), **change)
    task = paper_task(base=msgspec.structs.replace(base, **{section: changed}))
    with pytest.raises(InputError, match=told):
        _ = task.objective


def test_refuses_a_base_whose_gain_it_does_not_run():
    with pytest.raises(InputError, match=r"filter\.gain is 'noise'"):
        _ = paper_task(base=load_profile("adaptive")).objective


def test_refuses_a_base_with_conditioning():
    with pytest.raises(InputError, match="raw vectors"):
        _ = paper_task(base=load_profile("imu")).objective
