"""What is compiled ahead is what is called, and two processes do the work."""

import shutil
from pathlib import Path

import numba
import pytest

from estimator.estimator import Estimator
from estimator.live.resident import clock
from estimator.profile import load_profile
from service.warm_up import FOR_VELOCITY, UNAIDED, compile_ahead, rehearse
from tests.programs import run_python
from tests.traps import set_trap

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

COLD_START = """
import sys
from estimator.profile import load_profile
from service.warm_up import FOR_VELOCITY, UNAIDED, warm_up

warm_up(load_profile("imu"), None)
for half in (UNAIDED, FOR_VELOCITY):
    print({sum(kernel.stats.cache_misses.values()) for kernel in half})
print(any(name.startswith("scipy.linalg") for name in sys.modules))
import scipy.linalg.cython_blas
"""


def test_nothing_more_is_compiled_for_the_first_samples():
    profile = load_profile("imu")
    compile_ahead(profile, (*UNAIDED, *FOR_VELOCITY))
    ahead = {kernel: list(kernel.signatures) for kernel in (*UNAIDED, *FOR_VELOCITY)}
    rehearse(Estimator(profile), aided=True)
    assert {kernel: list(kernel.signatures) for kernel in ahead} == ahead
    assert all(len(signatures) == 1 for signatures in ahead.values())


def test_a_cold_start_finds_both_halves_as_others_have_compiled_them(tmp_path):
    """In a folder of somebody else's programs, none of which is run.

    Of each half one kernel is lacking: two processes are started, as for the whole of it. SciPy's
    linear algebra, which takes as long as all kernels, is left to whoever wants it afterwards.
    """
    trap, cache = tmp_path / "downloads", tmp_path / "cache"
    set_trap(trap)
    compile_ahead(load_profile("imu"), (*UNAIDED, *FOR_VELOCITY))
    compiled = Path(clock._cache.cache_path)
    shutil.copytree(compiled, cache / compiled.name)
    for kernel in ("clock", "hear"):
        lacking = list(cache.glob(f"*/estimator.live.resident.{kernel}-*"))
        assert len(lacking) == 2
        for file in lacking:
            file.unlink()
    program = ("-P", "-c", COLD_START)
    done = run_python(*program, folder=trap, timeout_s=900, NUMBA_CACHE_DIR=str(cache))
    assert done.stdout.split() == ["{0}", "{0}", "False"]
    assert done.stderr == ""
    assert len(list(cache.glob("*/estimator.live.resident.clock-*"))) == 2
    assert not (trap / "sprung").exists()
