"""A disk that fills up, by a limit on the size of a file: a line, and status 1."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

LOG = Path(__file__).parents[1] / "data" / "sitl_copter_flips.tlog"
LIMITED = """
import resource, sys
from fuzzbee.cli import entry_point
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
entry_point()
"""
pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs resource limits")


def limited(*arguments):
    return subprocess.Popen(
        [sys.executable, "-c", LIMITED, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )


def test_a_drawing_that_is_not_whole_is_told_while_the_run_goes_on(tmp_path):
    pytest.importorskip("rerun", reason="the extra viewer is not installed")
    file = tmp_path / "flight.rrd"
    done = limited(
        *("run", "sim:", "--seconds", "8", "--json", "--no-zenoh"),
        *("--rrd", str(file), "--profile", "paper"),
    )
    out, err = done.communicate(timeout=600)
    assert done.returncode == 1, err
    told = [line for line in err.splitlines() if "is not whole" in line]
    assert len(told) == 1 or "not closed in time: viewer" in err  # on a busy computer
    assert json.loads(out)["recording"] == "failed"
    assert json.loads(out)["vehicles"]["1"]["attitudes"] > 300


def test_a_replay_s_drawing_that_is_not_whole_is_status_1(tmp_path):
    pytest.importorskip("rerun", reason="the extra viewer is not installed")
    done = limited("replay", str(LOG), "--json", "--rrd", str(tmp_path / "flight.rrd"))
    _, err = done.communicate(timeout=600)
    assert done.returncode == 1
    assert err.count("is not whole") == 1


@pytest.mark.parametrize("option", ["--csv", "--mcap", "--parquet", "--tum"])
def test_an_export_that_finds_no_room_is_status_1_and_leaves_nothing(tmp_path, option):
    """A tenth of what the file needs may be written."""
    package = {"--mcap": "mcap", "--parquet": "pyarrow"}.get(option)
    if package is not None:
        pytest.importorskip(package)
    file = tmp_path / "flight.out"
    done = limited("replay", str(LOG), "--json", option, str(file))
    _, err = done.communicate(timeout=600)
    assert done.returncode == 1, err
    assert err.count("\n") == 1
    assert f"{option} {file}: File too large, not written" in err
    assert list(tmp_path.iterdir()) == []


def printed_to(redirection, *arguments):
    """The status and the lines on standard error, with standard output as a shell redirects it."""
    words = [sys.executable, "-m", "fuzzbee", *arguments]
    done = subprocess.run(
        ["/bin/sh", "-c", f'exec "$@" {redirection}', "sh", *words],
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=600,
    )
    return done.returncode, [line for line in done.stderr.splitlines() if "vehicle 1" not in line]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's full device")
@pytest.mark.parametrize("verb", [("replay", "--json"), ("check",), ("replay",)])
def test_a_full_standard_output_is_status_1(verb):
    status, lines = printed_to(">/dev/full", *verb, str(LOG))
    assert status == 1
    assert lines == ["fuzzbee: standard output: No space left on device"]


@pytest.mark.parametrize("verb", [("replay", "--json"), ("check", "--json"), ("replay",)])
def test_a_closed_standard_output_is_no_success(verb):
    status, lines = printed_to(">&-", *verb, str(LOG))
    assert status == 1
    assert lines == ["fuzzbee: standard output: it is closed"]


def test_a_service_does_without_its_standard_output():
    """A supervisor may close it."""
    status, _ = printed_to(">&-", "run", "sim:", "--seconds", "1", "--no-zenoh")
    assert status == 0
