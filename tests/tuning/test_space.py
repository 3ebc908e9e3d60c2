"""Whatever a search asks for becomes feasible, and stays what it was if it already is."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimator.filter.memberships import LOWER, UPPER, require_feasible
from tuning.space import (
    CONDITIONED_GROUPS,
    MEMBERSHIP,
    RAW_GROUPS,
    Parameter,
    decode,
    encode,
    make_feasible,
    random_positions,
    space_of,
)

anywhere = st.lists(st.floats(-300.0, 300.0), min_size=22, max_size=22)


@given(anywhere)
def test_any_position_becomes_feasible_and_stays_so(x):
    k = make_feasible(MEMBERSHIP, np.array([x]))
    require_feasible(tuple(k[0].tolist()))
    assert np.array_equal(make_feasible(MEMBERSHIP, k), k)


def test_only_broken_chains_and_bounds_change():
    k = 0.5 * (np.array(LOWER) + np.array(UPPER))
    k[0] = -1.0  # below its bound
    k[1], k[2] = 0.15, 0.05  # in the wrong order
    expected = k.copy()
    expected[0], expected[1], expected[2] = 0.0, 0.05, 0.15
    assert np.array_equal(make_feasible(MEMBERSHIP, k[None, :])[0], expected)


def test_random_positions_are_feasible_beside_other_groups_and_fill_the_bounds():
    space = space_of(("filter", "membership"), RAW_GROUPS)
    drawn = decode(space, random_positions(space, 2000, np.random.default_rng(1)))[:, 2:]
    for k in drawn[:200]:
        require_feasible(tuple(k.tolist()))
    # 2000 draws leave at most a few percent of a range that is open all the way
    assert (np.ptp(drawn, axis=0) / (np.array(UPPER) - np.array(LOWER))).min() > 0.8


def test_logarithmic_parameters_are_halved_in_the_middle():
    space = (Parameter("a", 0.1, 10.0), Parameter("b", -1.0, 3.0, is_logarithmic=False))
    middle = 0.5 * (encode(space, np.array([[0.1, -1.0]])) + encode(space, np.array([[10.0, 3.0]])))
    assert np.allclose(decode(space, middle), [[1.0, 1.0]], rtol=1e-15, atol=0)


@given(st.floats(-10.0, 10.0))
def test_decoded_values_never_leave_the_bounds(x):
    for space in (*RAW_GROUPS.values(), *CONDITIONED_GROUPS.values()):
        (values,) = decode(space, make_feasible(space, np.full((1, len(space)), x)))
        assert all(p.lower <= value <= p.upper for p, value in zip(space, values, strict=True))
