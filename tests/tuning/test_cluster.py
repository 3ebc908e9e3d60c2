"""A real Dask scheduler and two worker processes on loopback, one of which is killed."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import InputError
from tuning.objective import values_of
from tuning.optimizers import run_search
from tuning.paper_task import PaperTask, midpoint_profile
from tuning.search import Search, SearchOptions
from tuning.space import encode

pytest.importorskip("distributed")

from tuning.cluster import ClusterEvaluator

pytestmark = [
    pytest.mark.slow,
    # Dask's own: unclosed sockets of the connection to the worker that is killed
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]

REPOSITORY = Path(__file__).resolve().parents[2]
OPTIONS = SearchOptions("abc", food_sources=10, cycles=6, limit=220, seed=1)
TASK = PaperTask(midpoint_profile(), ("membership",), (100, 101), (200,))


def start(module, *arguments):
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", *arguments],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(process, words):
    """Read the log of a process until a line holds ``words``; that line."""
    seen = []
    for line in process.stderr:
        seen.append(line)
        if words in line:
            return line
    pytest.fail(f"the process ended without saying {words!r}:\n{''.join(seen)}")


def stop(process):
    process.kill()
    process.wait()
    process.stderr.close()


@pytest.fixture
def scheduler():
    process = start(
        "dask_scheduler",
        *("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show"),
        *("--dashboard-address", "127.0.0.1:0"),
    )
    try:
        yield wait_for(process, "Scheduler at:").split()[-1]
    finally:
        stop(process)


@pytest.fixture
def workers(scheduler, tmp_path):
    processes = [
        start(
            "dask_worker",
            scheduler,
            *("--host", "127.0.0.1", "--no-nanny", "--nthreads", "1", "--no-dashboard"),
            *("--dashboard-address", "127.0.0.1:0", "--local-directory", str(tmp_path / name)),
        )
        for name in ("one", "two")
    ]
    try:
        for process in processes:
            wait_for(process, "Registered to:")
        yield processes
    finally:
        for process in processes:
            stop(process)


def searched(evaluate, observe=lambda _: True):
    search = Search(TASK.space, OPTIONS, evaluate, observe)
    run_search(search, encode(TASK.space, values_of(TASK.space, TASK.base)))
    return search


def test_the_same_result_with_a_worker_killed_in_mid_run(scheduler, workers):
    here = searched(TASK.objective.costs)

    def kill_one(search):
        if search.evaluations >= OPTIONS.budget // 2 and workers[0].poll() is None:
            workers[0].send_signal(signal.SIGKILL)
            workers[0].wait()
        return True

    with ClusterEvaluator(scheduler, TASK.objective) as evaluate:
        there = searched(evaluate, kill_one)
    assert workers[0].returncode == -signal.SIGKILL
    assert workers[1].poll() is None
    assert np.array_equal(there.record.costs, here.record.costs)
    assert there.record.asked_sha256 == here.record.asked_sha256
    assert np.array_equal(there.best_values, here.best_values)


def test_no_scheduler_is_said_in_one_line(monkeypatch):
    monkeypatch.setattr("tuning.cluster.CONNECT_TIMEOUT_S", 0.5)
    with pytest.raises(InputError, match="no scheduler answers") as told:
        ClusterEvaluator("tcp://127.0.0.1:9", TASK.objective)
    assert "\n" not in str(told.value)


def test_no_workers_is_said_in_one_line(scheduler, monkeypatch):
    monkeypatch.setattr("tuning.cluster.CONNECT_TIMEOUT_S", 1.0)
    with pytest.raises(InputError, match="no workers"):
        ClusterEvaluator(scheduler, TASK.objective)
