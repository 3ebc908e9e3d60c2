import gc
import sys

import pytest

from estimator.compilation.compiled import is_compiled_code
from service.process import MANY_OBJECTS, SWITCH_INTERVAL_S, gc_settings
from tests.programs import run_python


def test_the_process_is_as_before_afterwards():
    interval_s, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    thresholds = gc.get_threshold()
    with gc_settings():
        assert abs(sys.getswitchinterval() - SWITCH_INTERVAL_S) < 1e-6
        assert gc.get_freeze_count() > 1000
        assert gc.get_threshold() == (MANY_OBJECTS, *thresholds[1:])
    assert gc.get_threshold() == thresholds
    assert sys.getswitchinterval() == interval_s
    assert gc.get_freeze_count() == frozen


def test_what_newcomers_bring_is_left_alone_too_once_a_second():
    with gc_settings() as add:
        add(0, 10.0)
        before = gc.get_freeze_count()
        brought = [[] for _ in range(1000)]
        add(1, 10.5)
        assert gc.get_freeze_count() <= before  # what is frozen may be freed meanwhile
        add(1, 11.0)
        assert gc.get_freeze_count() >= before + len(brought)
        before = gc.get_freeze_count()
        brought += [[] for _ in range(1000)]
        add(1, 12.0)
        assert gc.get_freeze_count() <= before


LOADED = """
from service.process import load_kernels
load_kernels()
is_code, kb = False, 0
for line in open("/proc/self/smaps"):
    if "-" in line.split()[0]:
        is_code = " r-xp " in line and "libllvmlite" in line
    elif is_code and line.startswith("Rss:"):
        kb += int(line.split()[1])
print(kb)
"""


@pytest.mark.skipif(sys.platform != "linux" or not is_compiled_code(), reason="nothing to free")
def test_the_compilers_code_takes_no_memory_once_kernels_are_loaded():
    done = run_python("-c", LOADED, timeout_s=600)
    assert int(done.stdout) < 8_000  # kB; 22,000 and more while they are loaded
