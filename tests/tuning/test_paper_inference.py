"""The rules in lanes against the plain ones."""

import platform

import numba
import numpy as np
import pytest

from estimator.compilation.compiled import compiled
from estimator.filter.fuzzy import fuzzy_gain
from tuning.paper_inference import LANES, RULE_SIZE, lane_gain, lay_rules
from tuning.paper_kernel import choose_gains
from tuning.space import decode, make_feasible, membership_space, random_positions


@compiled
def laid_gain(rows, k, error, rate):
    lay_rules(rows, k)
    return lane_gain(rows, 0, error, rate)


def corners(space, count, generator):
    """Memberships each of which is at one of its bounds: points, vertical edges, equal sets."""
    at_upper = generator.random((count, space.dimensions)) < 0.5
    return make_feasible(space, np.where(at_upper, space.upper, space.lower))


def inputs(k, generator):
    """Anywhere, at 0 and 1, at the corners, and as near to them as numbers go."""
    k = k[:11]
    beside = np.concatenate([np.nextafter(k, 1.0), np.nextafter(k, 0.0)])
    some = np.concatenate([generator.random(20) ** 3, [0.0, 1.0, 1e-17], k, beside])
    return some[(some == 0.0) | (some > 1e-100)]


@pytest.mark.parametrize("kind", ["anywhere", "at the bounds"])
def test_agrees_with_the_plain_rules(kind):
    generator, space = np.random.default_rng(3), membership_space()
    if kind == "anywhere":
        candidates = decode(space, random_positions(space, 100, generator))
    else:
        candidates = corners(space, 100, generator)
    rows = np.zeros(RULE_SIZE)
    for k in candidates:
        own, x = tuple(k.tolist()), inputs(k, generator)
        for e, d in zip(generator.choice(x, 40), generator.choice(x, 40), strict=True):
            expected = fuzzy_gain(own, float(e), float(d))
            assert laid_gain(rows, own, float(e), float(-d)) == pytest.approx(expected, rel=1e-13)


def test_no_rule_no_gain():
    """VS ends at 0.1, S begins at 0.2."""
    k = (0.1, 0.2, 0.2, 0.2, 0.2, 0.25, 0.35, 0.35, 0.5, 0.7, 0.7)
    k += (15.0, 20.0, 20.0, 30.0, 20.0, 50.0, 50.0, 50.0, 70.0, 90.0, 70.0)
    assert laid_gain(np.zeros(RULE_SIZE), k, 0.15, 0.0) == fuzzy_gain(k, 0.15, 0.0) == 0.0


@pytest.mark.skipif(
    numba.config.DISABLE_JIT or platform.machine() not in ("x86_64", "AMD64"),
    reason="reads the processor's instructions",
)
def test_the_inference_is_vector_instructions():
    """Measured: 160 multiplications of packed numbers, 41 of single ones for the exact decay."""

    def gains(state, fastest):
        choose_gains(state, LANES, fastest, 0.01)

    kernel = numba.njit("void(f8[::1], f8)", error_model="numpy", forceinline=True)(gains)
    (text,) = kernel.inspect_asm().values()
    assert text.count("mulpd") > 120
    assert text.count("mulsd") < 50
