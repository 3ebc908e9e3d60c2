"""The attitude from velocity alone, against truth and against SciPy's solution."""

from math import degrees

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.aiding import Report
from estimator.aiding.search import NOTHING_FOUND, felt, found, heard
from estimator.metrics import angle_errors
from estimator.types import STANDARD_GRAVITY_M_S2

DT = 0.02
GRAVITY = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


def searched(rng, *, seconds=20.0, push_m_s2=2.0, noise_m_s=0.05):
    """A search fed with random pushes, the true attitude of G, and the windows' vectors."""
    truth = Rotation.random(random_state=int(rng.integers(1 << 30)))
    search, velocity, push = NOTHING_FOUND, np.zeros(3), np.zeros(3)
    starts, windows = np.zeros(3), []
    force = np.zeros(3)
    for k in range(round(seconds / DT)):
        if k % 75 == 0:
            push = push_m_s2 * rng.standard_normal(3)
        velocity = velocity + push * DT
        acc = truth.inv().apply(push - GRAVITY)
        search = felt(search, (1.0, 0.0, 0.0, 0.0), tuple(acc.tolist()), DT)
        force = force + acc * DT
        said = velocity + noise_m_s * rng.standard_normal(3)
        before = search
        search, closed = heard(search, Report(True, tuple(said.tolist()), True, 0.3, 0.0, 0.0))
        if closed:
            windows.append((said - starts - GRAVITY * before.time_s, before.pushed_m_s))
        if closed or not before.is_open:
            starts = said
    return search, truth, windows


@pytest.mark.parametrize("seed", range(6))
def test_it_finds_the_attitude(seed):
    search, truth, _ = searched(np.random.default_rng(seed))
    answer = found(search)
    x, y, z, w = truth.as_quat()
    errors = np.degrees(angle_errors(answer.q_ned_g, (w, x, y, z)))
    assert np.max(errors) < 3.0
    assert errors[1] < 3.0 * degrees(answer.sigma_heading_rad) + 0.5


@pytest.mark.parametrize("seed", range(3))
def test_it_is_scipys_solution_of_the_same_windows(seed):
    """``Rotation.align_vectors`` with the weights that forgetting leaves."""
    search, _, windows = searched(np.random.default_rng(seed), seconds=8.0)
    a, b = (np.array(side) for side in zip(*windows, strict=True))
    weights = np.exp(-np.arange(len(a))[::-1] * 1.0 / 30.0)
    wanted, _ = Rotation.align_vectors(a, b, weights=weights)
    w, x, y, z = found(search).q_ned_g
    apart = (Rotation.from_quat([x, y, z, w]) * wanted.inv()).magnitude()
    assert degrees(apart) < 0.05  # windows are 1.00 to 1.02 s long


def test_a_vehicle_at_rest_shows_no_heading():
    search, _, _ = searched(np.random.default_rng(1), push_m_s2=0.0)
    assert search.windows > 5.0
    assert found(search) is None


def test_noise_is_no_motion():
    search, _, _ = searched(np.random.default_rng(2), push_m_s2=0.0, noise_m_s=1.0, seconds=60.0)
    assert found(search) is None


def test_one_push_is_not_enough():
    search, _, _ = searched(np.random.default_rng(3), seconds=2.5)
    assert found(search) is None
