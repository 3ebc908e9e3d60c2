"""The smoother's sums beside plain ones."""

import numpy as np
from scipy.spatial.transform import Rotation

from estimator.geometry.rotations import chained, exp, log, rotate
from estimator.smoothing.heading import SCALE_SIGMA, least_squares, variances
from estimator.smoothing.windows import low_passed

RNG = np.random.default_rng(5)


def test_chained_turns_are_their_products():
    turns = RNG.normal(0.0, 0.5, (137, 3))
    product, products = Rotation.identity(), []
    for turn in turns:
        product = product * Rotation.from_rotvec(turn)
        products.append(product.as_matrix())
    q = chained(exp(turns))
    made = Rotation.from_quat(q, scalar_first=True)
    assert np.allclose(made.as_matrix(), products, atol=1e-12)  # rounding
    assert np.allclose(log(exp(turns)), turns, atol=1e-12)
    vectors = RNG.normal(size=(137, 3))
    assert np.allclose(rotate(q, vectors), made.apply(vectors), atol=1e-12)


def test_the_heading_is_the_least_squares_solution_with_its_variances():
    """With the scale errors as three more unknowns of one dense system."""
    n = 40
    z, r, q = RNG.normal(size=n), RNG.uniform(0.1, 5.0, n), RNG.uniform(0.01, 1.0, n - 1)
    a = RNG.normal(0.0, 200.0, (n - 1, 3))
    steps = np.concatenate([np.diff(np.eye(n), axis=0), -a], axis=1)
    prior = np.diag(np.concatenate([1.0 / r, np.full(3, SCALE_SIGMA**-2)]))
    information = prior + steps.T @ np.diag(1.0 / q) @ steps
    told = np.concatenate([z / r, np.zeros(3)])
    x, by_scale = least_squares(z, r, q, a)
    assert np.allclose(x, np.linalg.solve(information, told)[:n], atol=1e-9)
    both = variances(r, q) + by_scale
    assert np.allclose(both, np.diag(np.linalg.inv(information))[:n], atol=1e-9)
    assert np.median(by_scale / both) > 0.1  # so that either part is seen


def test_the_low_pass_has_no_delay():
    time_s = np.arange(0.0, 100.0, 0.25)
    slow = np.sin(0.05 * time_s)[:, None]
    quick = np.sin(8.0 * time_s)[:, None]
    passed = low_passed(slow + quick, 1.0)[40:-40]
    assert np.allclose(passed, slow[40:-40], atol=0.01)  # the quick one, 60 times smaller
