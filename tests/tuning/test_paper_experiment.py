import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.profile import load_profile
from tuning.paper_experiment import run_experiment


def test_its_figures_are_those_of_the_paper_and_of_scipy():
    """The angle, the paper's sum, and when the error is first below one percent.

    It starts next to the unstable equilibrium.
    """
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


def test_the_fuzzy_gain_beats_fixed_ones_within_the_papers_window():
    """The paper's claim for its own window and its own noise, on seeds that no parameter was chosen
    on: cheaper, and steadier over 4..14 s. No more is claimed: see docs/gains.md."""
    paper = load_profile("paper")
    seeds = range(9000, 9016)

    def mean(gain):
        results = [run_experiment(paper, seed, gain) for seed in seeds]
        steady = np.mean([r.steady_state_error for r in results])
        return np.mean([r.cost for r in results]), steady

    cost, steady = mean(None)
    fixed = [mean(gain) for gain in (1.0, 5.0, 7.0, 10.0, 20.0, 50.0, 70.0, 100.0)]
    assert cost < 0.85 * min(c for c, _ in fixed)
    assert steady < min(s for _, s in fixed)
