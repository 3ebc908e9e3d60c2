"""A real Dask scheduler and two worker processes on loopback, one of which is killed."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import pytest

from fuzzbee.cli import main
from tests.fuzzbee.processes import begun, cpu_s, started
from tests.programs import ROOT

pytest.importorskip("distributed")

pytestmark = pytest.mark.slow

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


@pytest.mark.parametrize("has_scheduler", [False, True])
def test_what_is_missing_is_reported_in_one_line(
    has_scheduler, request, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr("tuning.processes.CONNECT_TIMEOUT_S", 1.0)
    address, reported = "tcp://127.0.0.1:9", "no scheduler answers"
    if has_scheduler:
        address, reported = request.getfixturevalue("scheduler"), "no workers"
    file = tmp_path / "x.toml"
    assert main(["tune", *SEARCH, "-o", str(file), "--cluster", address]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("fuzzbee")]
    assert reported in line
