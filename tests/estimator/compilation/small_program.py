"""A program with one kernel, which compiles within a second, in a process of its own."""

import os

from tests.programs import run_python

SMALL_PROGRAM = """
from estimator.filter.noise_gain import noise_surface
print([noise_surface(1.0 + 0.01 * i, 0.01 * i, 0.013 * i).hex() for i in range(101)])
"""
MISSES = "print(sum(noise_surface.stats.cache_misses.values()))\n"
PLACE = "print(noise_surface._cache.cache_path)\n"


def run(program=SMALL_PROGRAM, **environment):
    """The program, which sees the packages under test."""
    inherited = {key: value for key, value in os.environ.items() if "NUMBA" not in key}
    return run_python("-c", program, timeout_s=120, inherited=inherited, **environment)
