"""A first start: attitudes at once, compiled code later, and nothing left behind."""

import json
import time
from pathlib import Path

import numba
import pytest

from estimator.compilation.interpreted import is_interpreting
from estimator.estimator import Estimator
from estimator.live.resident import Resident
from estimator.profile import load_profile
from service.compiling import BEGUN, Compiling
from service.warm_up import rehearse, warm_up
from tests.programs import run_python

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

PATIENCE_S = 300.0


def holds_compiled_memory(estimator):
    return isinstance(estimator._state.core._inside, Resident)


def test_estimators_change_over_to_compiled_code_where_they_are():
    profile = load_profile("imu")
    warm_up(profile, None)
    with Compiling(profile, None) as compiling:
        assert is_interpreting()
        estimator = Estimator(profile)
        rehearse(estimator, aided=True)
        assert not holds_compiled_memory(estimator)
        before, end_s = estimator.snapshot, time.monotonic() + PATIENCE_S
        while not (said := compiling.change_over(lambda: [estimator])) and time.monotonic() < end_s:
            time.sleep(0.01)
        assert "compiled" in said[0].text
        assert not is_interpreting()
        assert estimator.snapshot == before
        estimator.attitude(before.core.time_us)
        assert holds_compiled_memory(estimator)
        assert compiling.change_over(lambda: [estimator]) == []


def test_a_first_start_does_not_wait_for_the_compiler(tmp_path):
    """It has its attitudes, says why they cost more, and its helpers end with it."""
    command = ["run", "sim:flight", "--seconds", "3", "--json", "--no-zenoh"]
    program = ("-P", "-m", "fuzzbee", *command)
    done = run_python(*program, timeout_s=PATIENCE_S, NUMBA_CACHE_DIR=str(tmp_path))
    assert BEGUN in done.stderr
    assert json.loads(done.stdout)["vehicles"]["1"]["attitudes"] > 0
    assert not [
        line
        for path in Path("/proc").glob("[0-9]*/environ")
        if (line := _read(path)) and str(tmp_path).encode() in line
    ]


HELPER_OF_A_PARENT = """
import os, signal
from estimator.profile import load_profile
from pathlib import Path
from service.warm_up import await_end, helpers

with helpers(load_profile("imu")) as started:
    print(*(helper.pid for helper in started), flush=True)
    stopped = started[1]
    while len(list(Path(f"/proc/{stopped.pid}/task").iterdir())) < 2:
        pass
    stopped.send_signal(signal.SIGSTOP)
    await_end(stopped)  # nobody waits for it
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_helpers_end_with_a_service_that_is_killed(tmp_path):
    program = ("-P", "-c", HELPER_OF_A_PARENT)
    there = str(tmp_path)
    done = run_python(*program, timeout_s=PATIENCE_S, check=False, NUMBA_CACHE_DIR=there)
    helpers = [int(number) for number in done.stdout.split()]
    assert len(helpers) == 2
    end_s = time.monotonic() + 60.0
    while any(_is_running(helper) for helper in helpers) and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not any(_is_running(helper) for helper in helpers)


def _is_running(process):
    status = _read(Path(f"/proc/{process}/stat"))
    return status is not None and status.rpartition(b")")[2].split()[0] != b"Z"


def _read(path):
    try:
        return path.read_bytes()
    except OSError:
        return None
