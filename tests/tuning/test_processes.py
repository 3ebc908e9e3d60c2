"""Processes that compute for another one, which may be killed at any moment."""

import os
import signal
import sys
import time

import numpy as np
import pytest

from tests.fuzzbee.processes import begun, descendants, is_alive
from tests.programs import ROOT
from tests.service.sessions import wait_for
from tuning.processes import ENDING, Pool

ROWS = [np.array(row) for row in ((3.0, 4.0), (0.0, 1.0), (6.0, 8.0))]


def square(row):
    """The simplest work."""
    return float(np.sum(row**2))


def own_pid(row):
    """Work that tells who does it, one thing at a time."""
    time.sleep(row)
    return os.getpid()


@pytest.mark.parametrize("number", ENDING)
def test_what_is_to_end_the_parent_ends_no_worker(number):
    """Not even before it runs a line of ours: a terminal sends it to all."""
    others = {*descendants(os.getpid())}  # such as the tracker of another test's semaphores
    with Pool(square, 2) as pool:
        answers = pool(ROWS)
        first = next(answers)
        for process in {*descendants(os.getpid())} - others:
            os.kill(process, number)
        assert [first, *answers, *pool(ROWS)] == [25.0, 1.0, 100.0] * 2


def test_a_worker_that_is_killed_is_an_error_and_one_process_is_this_one():
    with Pool(own_pid, 1) as alone, Pool(own_pid, 2) as pool:
        assert [*alone([0.0])] == [os.getpid()]
        (worker,) = pool([0.0])
        os.kill(worker, signal.SIGKILL)
        with pytest.raises(ChildProcessError, match="has ended"):
            list(pool([0.0] * 8))


PROGRAM = """
from tests.tuning.test_processes import own_pid
from tuning.processes import Pool
if __name__ == "__main__":
    with Pool(own_pid, 2) as pool:
        answers = pool([0.0, 600.0, 600.0])
        print(next(answers), flush=True)
        next(answers)
"""


def test_a_parent_that_is_killed_takes_its_workers_along(tmp_path):
    """Nor do modules of the folder it stands in get into them."""
    folder, program = tmp_path / "folder", tmp_path / "program.py"
    folder.mkdir()
    (folder / "multiprocessing.py").write_text("raise SystemExit('a stranger')")
    program.write_text(PROGRAM)
    environment = {**os.environ, "PYTHONPATH": ROOT}
    with begun(sys.executable, program, cwd=folder, env=environment, stderr=None) as process:
        worker = int(process.stdout.readline())
        workers = descendants(process.pid)
        assert worker in workers
        process.kill()
        wait_for(lambda: not any(map(is_alive, workers)))
