"""Processes that compute for another one, which may be killed at any moment."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

from fuzzbee.cli import main
from tests.fuzzbee.processes import begun, cpu_s, descendants, is_alive, started
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


# --- a real Dask scheduler and two worker processes on loopback, one of which is killed

LOOPBACK = ("--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0")
SEARCH = ["sim:", "--sources", "10", "--cycles", "300", "--noise-seeds", "100-101"]
SEARCH += ["--held-out-seeds", "200"]


@contextmanager
def running(module, words, *options):
    """A process of Dask once a line of its log holds ``words``, and that line."""
    command = (sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}")
    environment = {**os.environ, "PYTHONPATH": ROOT}
    settings = {"env": environment, "stdout": subprocess.DEVNULL}
    with begun(*command, *options, *LOOPBACK, **settings) as process:
        try:
            line = next((line for line in process.stderr if words in line), None)
            assert line, "it has ended"
            yield process, line
        finally:
            process.kill()


@pytest.fixture
def scheduler():
    pytest.importorskip("distributed")
    with running("dask_scheduler", "Scheduler at:", "--port", "0", "--no-show") as (_, line):
        yield line.split()[-1]


@pytest.fixture
def workers(scheduler, tmp_path):
    to = ("dask_worker", "Registered to:", scheduler)
    alone = ("--no-nanny", "--nthreads", "1", "--local-directory")
    with (
        running(*to, *alone, tmp_path / "one") as (first, _),
        running(*to, *alone, tmp_path / "two") as (second, _),
    ):
        yield first, second


@pytest.mark.slow
def test_the_same_file_with_a_worker_killed_in_mid_run(scheduler, workers, tmp_path):
    here, there = tmp_path / "here.toml", tmp_path / "there.toml"
    assert main(["tune", *SEARCH, "-o", str(here)]) == 0
    idle_s = cpu_s(workers[0].pid)
    with started("tune", *SEARCH, "-o", str(there), "--cluster", scheduler) as process:
        while cpu_s(workers[0].pid) < idle_s + 1.0:
            assert process.poll() is None
            time.sleep(0.01)
        workers[0].send_signal(signal.SIGKILL)
        _, output = process.communicate(timeout=300)
        assert process.returncode == 0, output
    assert workers[1].poll() is None
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("has_scheduler", [False, True])
def test_what_is_missing_is_reported_in_one_line(
    has_scheduler, request, tmp_path, monkeypatch, capsys
):
    pytest.importorskip("distributed")
    monkeypatch.setattr("tuning.processes.CONNECT_TIMEOUT_S", 1.0)
    address, reported = "tcp://127.0.0.1:9", "no scheduler answers"
    if has_scheduler:
        address, reported = request.getfixturevalue("scheduler"), "no workers"
    assert main(["tune", *SEARCH, "-o", str(tmp_path / "x.toml"), "--cluster", address]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("fuzzbee")]
    assert reported in line
