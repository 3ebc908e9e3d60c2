"""The largest eigenvalue in closed form, against NumPy's."""

import numpy as np
import pytest

from estimator.live.iron import largest_eigenvalue


@pytest.mark.parametrize("seed", range(20))
def test_the_largest_eigenvalue_is_numpys(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 3)) * 10.0 ** rng.uniform(-4, 2)
    S = A @ A.T
    found = largest_eigenvalue(tuple(np.diag(S)), (S[1, 2], S[0, 2], S[0, 1]))
    assert found == pytest.approx(np.linalg.eigvalsh(S)[-1], rel=1e-9)


def test_of_equal_axes_it_is_theirs():
    assert largest_eigenvalue((2.0, 2.0, 2.0), (0.0, 0.0, 0.0)) == 2.0
