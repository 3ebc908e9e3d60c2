"""A search that is watched, interrupted and resumed, or computed by others is the same search."""

import json
import os
import signal
import time

import pytest

from estimator.profile import load_profile
from fuzzbee.cli import main
from tests.fuzzbee.processes import FUZZBEE, begun, cpu_s, descendants, started

pytest.importorskip("rerun", reason="the extra viewer is not installed")

from fuzzbee.viewer.stream import CLOSED
from tests.fuzzbee.screen import listing, rows

SEEDS = ["--noise-seeds", "100-101", "--held-out-seeds", "200"]
SMALL = ["tune", "sim:", *SEEDS, "--sources", "6", "--cycles", "4"]


@pytest.mark.parametrize("algorithm", ["abc", "cmaes", "de"])
def test_the_same_options_give_one_file_and_all_cycles_are_shown(tmp_path, algorithm, monkeypatch):
    """Whether somebody watches, for any number of threads, and where closing takes too long."""
    monkeypatch.setattr("fuzzbee.viewer.stream.CLOSE_FLUSH_S", 0.0)
    if algorithm == "cmaes":
        pytest.importorskip("cmaes")
    alone, watched, file = (tmp_path / name for name in ("a.toml", "w.toml", "w.rrd"))
    options = [*SMALL, "--algorithm", algorithm]
    assert main([*options, "-o", str(alone), "--threads", "2"]) == 0
    assert main([*options, "-o", str(watched), "--threads", "1", "--rrd", str(file)]) == 0
    assert watched.read_bytes() == alone.read_bytes()
    text = listing(file)
    for entity in ("/cost", "/best"):
        assert f" {entity} " in text, entity
    if algorithm == "abc":
        assert rows(file, "/cost") == 4 + 1  # the names


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_and_resumed_is_the_same_file_and_shows_what_was_before(tmp_path, number):
    """All processes get the signal, as at a terminal, once the workers compute."""
    options = ["tune", "sim:", "--sources", "40", "--cycles", "200", "--noise-seeds", "100-103"]
    options += ["--held-out-seeds", "200"]
    whole, broken, file = (tmp_path / name for name in ("whole.toml", "broken.toml", "x.rrd"))
    command = (*FUZZBEE, *options, "-o", broken, "--json", "--threads", "2")
    with begun(*command, start_new_session=True) as process:
        while len([p for p in descendants(process.pid) if cpu_s(p) > 1.5]) < 2:
            assert process.poll() is None
            time.sleep(0.05)
        os.killpg(process.pid, number)
        out, err = process.communicate()
    answer = json.loads(out)
    assert process.returncode == 130
    assert answer["interrupted"]
    assert 0 < answer["evaluations"] < 40 * 401
    checkpoint = tmp_path / "broken.toml.checkpoint"
    assert err.splitlines()[0] == f"interrupted: --resume goes on from {checkpoint}"
    assert "interrupted after" in load_profile(str(broken)).provenance.description
    assert main([*options, "-o", str(whole)]) == 0
    resumed = [*options, "-o", str(broken), "--resume", "--threads", "1", "--rrd", str(file)]
    assert main(resumed) == 0
    assert broken.read_bytes() == whole.read_bytes()
    assert rows(file, "/cost") == 200 + 1
    assert not checkpoint.exists()


def test_a_viewer_that_ends_ends_nothing_else(tmp_path):
    """Its process is killed in the middle of the search."""
    watched, alone = tmp_path / "w.toml", tmp_path / "a.toml"
    options = ["tune", "sim:", "--sources", "30", "--cycles", "60", *SEEDS, "--threads", "1"]
    with started(*options, "-o", str(watched), "--view", "web") as process:
        assert "the viewer is at" in process.stderr.readline()
        (viewer,) = descendants(process.pid)
        os.kill(viewer, signal.SIGKILL)
        _, printed = process.communicate(timeout=60)
        assert (process.returncode, printed) == (0, f"fuzzbee: viewer {CLOSED}\n")
    assert main([*options, "-o", str(alone)]) == 0
    assert watched.read_bytes() == alone.read_bytes()
