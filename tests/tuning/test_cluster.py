"""A real Dask scheduler and two worker processes on loopback, one of which is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fuzzbee.cli import main
from tests.fuzzbee.processes import cpu_s, started

pytest.importorskip("distributed")

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]
SEARCH = ["sim:", "--sources", "10", "--cycles", "300", "--noise-seeds", "100-101"]
SEARCH += ["--held-out-seeds", "200"]


def start(module, *arguments):
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", *arguments],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
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


def test_the_same_file_with_a_worker_killed_in_mid_run(scheduler, workers, tmp_path):
    here, there = tmp_path / "here.toml", tmp_path / "there.toml"
    assert main(["tune", *SEARCH, "-o", str(here)]) == 0
    idle_s = cpu_s(workers[0].pid)
    with started("tune", *SEARCH, "-o", str(there), "--cluster", scheduler) as process:
        while cpu_s(workers[0].pid) < idle_s + 1.0:
            assert process.poll() is None
            time.sleep(0.01)
        workers[0].send_signal(signal.SIGKILL)
        _, said = process.communicate(timeout=300)
        assert process.returncode == 0, said
    assert workers[1].poll() is None
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.parametrize("has_scheduler", [False, True])
def test_what_is_missing_is_said_in_one_line(has_scheduler, request, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("tuning.cluster.CONNECT_TIMEOUT_S", 1.0)
    address, told = "tcp://127.0.0.1:9", "no scheduler answers"
    if has_scheduler:
        address, told = request.getfixturevalue("scheduler"), "no workers"
    file = tmp_path / "x.toml"
    assert main(["tune", *SEARCH, "-o", str(file), "--cluster", address]) == 2
    (line,) = [x for x in capsys.readouterr().err.splitlines() if x.startswith("fuzzbee")]
    assert told in line
