"""Kernels of parts: machine code of the whole only, and no memory lost or freed too early."""

from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python, rtsys

from estimator.compilation.compiled import compiled, inlined

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


class Pair(NamedTuple):
    numbers: np.ndarray
    offset: float


@inlined
def moved(pair, by):
    """A new array; the one before is forgotten."""
    return Pair(pair.numbers + by, pair.offset - by)


@compiled
def swung(numbers, times):
    pair = Pair(numbers, 0.0)
    for k in range(times):
        pair = moved(pair, 1.0) if k % 2 else moved(moved(pair, 2.0), -3.0)
    return pair


@compiled
def doubled(x):
    return 2.0 * x


@compiled
def quadrupled(x):
    return doubled(doubled(x))


@pytest.fixture
def held():
    """How many arrays there are that compiled code has made, and not yet freed."""
    _nrt_python.memsys_enable_stats()
    before = rtsys.get_allocation_stats()

    def count():
        now = rtsys.get_allocation_stats()
        return now.mi_alloc - before.mi_alloc - (now.mi_free - before.mi_free)

    yield count
    _nrt_python.memsys_disable_stats()


def test_arrays_in_tuples_are_counted_through_parts(held):
    numbers = np.arange(3.0)
    pairs = [swung(numbers, times) for times in range(1, 6)]
    for times, pair in enumerate(pairs, 1):
        expected = swung.py_func(numbers, times)
        assert pair.numbers.tolist() == expected.numbers.tolist()
        assert pair.offset == expected.offset
    assert held() == len(pairs)
    del pairs, pair
    assert held() == 0
    assert numbers.tolist() == [0.0, 1.0, 2.0]


def test_a_kernel_inside_another_is_a_part_of_it():
    assert quadrupled(1.5) == 6.0
    assert doubled.signatures == []  # it has no machine code of its own
    assert doubled(1.5) == 3.0
