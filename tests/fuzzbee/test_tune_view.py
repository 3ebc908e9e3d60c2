"""``tune --view`` and ``--rrd``: a search that is watched is the same search."""

import os
import signal
import time
from pathlib import Path

import pytest

from fuzzbee.cli import main
from tests.fuzzbee.processes import cpu_s, started

pytest.importorskip("rerun", reason="the extra viewer is not installed")

from fuzzbee.viewer.stream import CLOSED
from tests.fuzzbee.rrd import listing, rows

SMALL = ["--sources", "6", "--cycles", "4"]
SIMULATED = ["tune", "sim:", *SMALL, "--noise-seeds", "100-101", "--held-out-seeds", "200"]
ENTITIES = {"/cost", "/best"}
WATCHED = ["--view", "web", "--threads", "1"]  # the viewer is the only other process


@pytest.mark.parametrize("algorithm", ["abc", "cmaes", "de"])
def test_it_shows_every_cycle_and_changes_nothing(tmp_path, algorithm):
    if algorithm == "cmaes":
        pytest.importorskip("cmaes")
    alone, watched, file = (tmp_path / name for name in ("a.toml", "w.toml", "w.rrd"))
    options = [*SIMULATED, "--algorithm", algorithm]
    assert main([*options, "-o", str(alone)]) == 0
    assert main([*options, "-o", str(watched), "--rrd", str(file)]) == 0
    assert watched.read_bytes() == alone.read_bytes()
    text = listing(file)
    for entity in ENTITIES:
        assert f" {entity} " in text, entity
    if algorithm == "abc":
        assert rows(file, "/cost") == 4 + 1  # the names


def test_a_resumed_search_shows_what_was_before(tmp_path):
    output, file = tmp_path / "x.toml", tmp_path / "x.rrd"
    options = [*SIMULATED[:2], "--sources", "40", "--cycles", "1000", *SIMULATED[-4:]]
    with started(*options, "-o", str(output), "--threads", "1") as process:
        while cpu_s(process.pid) < 4.0:
            assert process.poll() is None
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode == 130
    assert main([*options, "-o", str(output), "--resume", "--rrd", str(file)]) == 0
    assert rows(file, "/cost") == 1000 + 1


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's list of children")
def test_a_viewer_that_ends_ends_nothing_else(tmp_path):
    """Its process is killed in the middle of the search."""
    watched, alone = tmp_path / "w.toml", tmp_path / "a.toml"
    options = [*SIMULATED[:2], "--sources", "30", "--cycles", "60", *SIMULATED[-4:]]
    with started(*options, "-o", str(watched), *WATCHED) as process:
        assert "the viewer is at" in process.stderr.readline()
        (viewer,) = children(process.pid)
        os.kill(viewer, signal.SIGKILL)
        _, printed = process.communicate(timeout=60)
        assert process.returncode == 0
        assert printed == f"fuzzbee: viewer {CLOSED}\n"
    assert main([*options, "-o", str(alone)]) == 0
    assert watched.read_bytes() == alone.read_bytes()


def children(pid):
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for path in tasks for word in path.read_text().split()]
