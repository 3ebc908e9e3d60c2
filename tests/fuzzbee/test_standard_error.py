"""Output for people decides over nothing: standard error that nobody reads, or that is full."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

FULL = Path("/dev/full")


def command(*arguments):
    return [sys.executable, "-m", "fuzzbee", *arguments]


RUN = ("run", "--no-zenoh", "--seconds", "1.5", "--json", "--profile", "paper")


def broken_pipe():
    """The writing end of a pipe that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)
    return os.fdopen(writing, "w")


@pytest.mark.parametrize(
    "errors",
    [
        pytest.param(
            lambda: FULL.open("w"),
            marks=pytest.mark.skipif(not FULL.exists(), reason="needs /dev/full"),
            id="full",
        ),
        pytest.param(broken_pipe, id="broken"),
    ],
)
def test_a_run_goes_on_and_its_result_is_whole(errors):
    with errors() as stderr:
        done = subprocess.run(
            command(*RUN), stdout=subprocess.PIPE, stderr=stderr, check=False, timeout=120
        )
    assert done.returncode == 0
    assert json.loads(done.stdout)["vehicles"]["1"]["attitudes"] > 100


def test_standard_output_that_is_closed_leaves_the_messages():
    """A table that nobody reads: the service goes on, and says at the end what it came to."""
    with broken_pipe() as stdout:
        done = subprocess.run(
            command(*[word for word in RUN if word != "--json"]),
            stdout=stdout,
            stderr=subprocess.PIPE,
            check=False,
            timeout=900,
            text=True,
        )
    assert done.returncode == 0
    assert "attitudes of 1 vehicle" in done.stderr


def test_a_result_that_cannot_be_written_is_a_failure():
    if not FULL.exists():
        pytest.skip("needs /dev/full")
    with FULL.open("w") as stdout:
        done = subprocess.run(
            command(*RUN),
            stdout=stdout,
            stderr=subprocess.PIPE,
            check=False,
            timeout=900,
            text=True,
        )
    assert done.returncode == 1
    assert "No space left" in done.stderr


def test_a_reader_that_leaves_in_the_middle():
    """It is ended by nothing but its signal, with everything said on standard output."""
    arguments = command("run", "--no-zenoh", "--json", "-v")
    pipe = subprocess.PIPE
    with subprocess.Popen(arguments, stdout=pipe, stderr=pipe) as process:
        process.stderr.readline()
        process.stderr.close()
        time.sleep(1.5)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        out = process.stdout.read()
        assert process.wait(60) == 0
    assert json.loads(out)["vehicles"]["1"]["attitudes"] > 50


LOG = Path(__file__).parents[1] / "data" / "sitl_copter_flips.tlog"


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="needs /dev/stdout")
@pytest.mark.parametrize("lines", [2, 1002])
def test_rows_on_standard_output_are_read_as_far_as_somebody_wants(lines):
    """A pipe has no path of its own; it was told to be no file."""
    arguments = command("replay", str(LOG), "--csv", "/dev/stdout")
    pipe = subprocess.PIPE
    with subprocess.Popen(arguments, stdout=pipe, stderr=pipe, text=True) as process:
        rows = [process.stdout.readline() for _ in range(lines)]
        process.stdout.close()
        said = process.stderr.read()
        assert process.wait(600) == 0, said
    assert rows[0].startswith("time_s,")
    assert all(row.count(",") == rows[0].count(",") for row in rows[:1001])
    assert "/dev/stdout" not in said


def test_an_output_of_few_letters_gets_what_it_can():
    """Degrees and signs have no code in ASCII: the lines come all the same, with question marks."""
    done = subprocess.run(
        [sys.executable, "-m", "fuzzbee", "run", "sim:", "--seconds", "2.5", "--no-zenoh"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stdout.splitlines() if b"roll" in line]
    assert len(lines) >= 2
    assert all(b"?" in line for line in lines)


PRINTING = """
import os, sys
from fuzzbee import cli

def print_as_libraries_do():
    with open(sys.argv[1], "w"):  # a recording
        for number in range(3):
            os.write(number, b"panicked")
    return 0

cli.main = print_as_libraries_do
cli.entry_point()
"""


def test_streams_that_are_closed_do_not_lead_into_the_next_file(tmp_path):
    file = tmp_path / "recording"
    closed = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, "-c", PRINTING, str(file)]
    assert subprocess.run(closed, check=False, timeout=120).returncode == 0
    assert file.read_bytes() == b""
