"""A program with one kernel, which compiles within a second, on a copy of our sources."""

import os
import shutil
from pathlib import Path

import drivers
import estimator
import tuning
from tests.programs import run_python

SMALL_PROGRAM = """
from estimator.filter.noise_gain import noise_surface
print([noise_surface(1.0 + 0.01 * i, 0.01 * i, 0.013 * i).hex() for i in range(101)])
"""
MISSES = "print(sum(noise_surface.stats.cache_misses.values()))\n"
PLACE = "print(noise_surface.stats.cache_path)\n"


def copy_sources(folder):
    """Our packages without kernels, in a folder of a test's own."""
    for package in (estimator, drivers, tuning):
        source = Path(package.__file__).parent
        ignored = shutil.ignore_patterns("__pycache__", "kernels")
        shutil.copytree(source, folder / source.name, ignore=ignored)
    return folder


def run(program=SMALL_PROGRAM, *, sources, **environment):
    """The program's output, errors and status; it sees the packages in ``sources``."""
    inherited = {key: value for key, value in os.environ.items() if "NUMBA" not in key}
    environment["PYTHONPATH"] = str(sources)
    command = ("-P", "-c", program)
    return run_python(*command, timeout_s=300, inherited=inherited, **environment)
