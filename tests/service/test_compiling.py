"""A first start: attitudes at once, compiled code later, and nothing left behind."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

import service
from estimator.compilation.interpreted import is_interpreting
from estimator.estimator import Estimator
from estimator.live.resident import Resident
from estimator.profile import load_profile
from service.compiling import BEGUN, Compiling
from service.warm_up import rehearse, warm_up

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")

PATIENCE_S = 300.0
ROOT = str(Path(next(iter(service.__path__))).parent)


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
    path = os.pathsep.join(filter(None, [ROOT, os.environ.get("PYTHONPATH", "")]))
    command = ["run", "sim:flight", "--seconds", "3", "--json", "--no-zenoh"]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "fuzzbee", *command],
        env={**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE_S,
    )
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
    path = os.pathsep.join(filter(None, [ROOT, os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [sys.executable, "-P", "-c", HELPER_OF_A_PARENT],
        check=False,
        env={**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
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
