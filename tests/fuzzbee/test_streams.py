"""Redirected streams, pipes and odd files, full, closed or left alone: a line, no endless wait."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from drivers.mavlink.encoder import signing_key
from fuzzbee import security
from fuzzbee.cli import main
from tests.fuzzbee.processes import free_port, shell
from tests.fuzzbee.recording import FLIPS, TAKEOFF

RUN = ("run", "sim:", "--no-zenoh", "--seconds", "1.5", "--profile", "paper")
REPLAY = ("replay", str(FLIPS))
CHECK = ("check", str(FLIPS))
JSON = "--json"
KERNEL_LOG = Path("/proc/kmsg")  # a file by its mode, without a size; to read it blocks
SMALL = "ulimit -f 40;"  # no file may have more kilobytes

pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's full device")


@pytest.fixture(scope="module", autouse=True)
def _compiled():
    """What is compiled at the first start is reported by then."""
    shell('"$@"', "replay", "sim:", JSON)


@pytest.mark.parametrize(
    ("line", "arguments", "status", "output"),
    [
        ('"$@" >/dev/full', (*RUN, JSON), 1, "No space left"),
        ('"$@" >/dev/full', (*REPLAY, JSON), 1, "standard output: No space left on device"),
        ('"$@" >/dev/full', REPLAY, 1, "standard output: No space left on device"),
        ('"$@" >/dev/full', CHECK, 1, "standard output: No space left on device"),
        ('"$@" >&-', (*REPLAY, JSON), 1, "standard output: it is closed"),
        ('"$@" >&-', REPLAY, 1, "standard output: it is closed"),
        ('"$@" >&-', (*CHECK, JSON), 1, "standard output: it is closed"),
        ('"$@" >&-', (*RUN, JSON), 1, "standard output: it is closed"),
        ('"$@" >&-', RUN, 0, "attitudes of 1 vehicle"),  # as a supervisor may start a service
        ('"$@" | true', RUN, 0, "attitudes of 1 vehicle"),  # a table that nobody reads
        ('"$@" | true', ("replay", "sim:", JSON), 0, ""),
        ('"$@" | head -n 2', (*REPLAY, "--csv", "/dev/stdout"), 0, ""),
        ('"$@" | head -n 1002', (*REPLAY, "--csv", "/dev/stdout"), 0, ""),
    ],
)
def test_a_failing_output_is_a_line_and_a_closed_pipe_is_none(line, arguments, status, output):
    done = shell(line, *arguments, status=status)
    assert output in done.stderr
    assert not [word for word in ("Traceback", "Broken") if word in done.stderr]
    if "/dev/stdout" in arguments:
        rows = done.stdout.splitlines()
        assert rows[0].startswith("time_s,")
        assert {row.count(",") for row in rows[:1001]} == {rows[0].count(",")}
    if status:
        assert done.stderr.splitlines()[-1].startswith("fuzzbee: ")


@pytest.mark.parametrize("redirection", ["2>/dev/full", "2>&-", "2> >(head -n 1 >/dev/null)"])
def test_a_run_goes_on_without_its_messages_and_its_result_is_whole(redirection):
    done = shell(f'"$@" {redirection}', *RUN, JSON, "-v")
    assert json.loads(done.stdout)["vehicles"]["1"]["attitudes"] > 0


def test_an_output_of_few_letters_gets_what_it_can():
    """Degrees and signs have no code in ASCII: the lines come all the same, with question marks."""
    done = shell('"$@"', *RUN[:4], "2.5", PYTHONIOENCODING="ascii")
    lines = [line for line in done.stdout.splitlines() if "roll" in line]
    assert len(lines) >= 2
    assert all("?" in line for line in lines)


PRINTING = """
import os, sys
from fuzzbee import cli
def print_as_libraries_do():
    with open(sys.argv[1], 'w'):
        for number in range(3):
            os.write(number, b'panicked')
    return 0
cli.main = print_as_libraries_do
cli.entry_point()
"""


def test_streams_that_are_closed_do_not_lead_into_the_next_file(tmp_path):
    """What a library prints is not in the recording that was opened first."""
    file = tmp_path / "recording"
    line = ["sh", "-c", 'exec "$0" -c "$1" "$2" <&- >&- 2>&-', sys.executable, PRINTING, file]
    assert subprocess.run(line, check=False, timeout=120).returncode == 0
    assert file.read_bytes() == b""


@pytest.mark.parametrize("verb", [(*RUN[:4], "8", JSON), (*REPLAY, JSON)])
def test_a_drawing_that_is_not_whole_is_reported_and_all_else_is_there(tmp_path, verb):
    pytest.importorskip("rerun", reason="the extra viewer is not installed")
    done = shell(f'{SMALL} "$@"', *verb, "--rrd", tmp_path / "flight.rrd", status=1)
    reported = done.stderr.count("is not whole")
    assert reported == 1 or "not closed in time: viewer" in done.stderr  # on a busy computer
    result = json.loads(done.stdout)
    if verb[0] == "run":
        assert result["recording"] == "failed"
        assert result["vehicles"]["1"]["attitudes"] > 0


def test_a_drawing_on_a_disk_that_is_full_from_the_start_is_status_1():
    pytest.importorskip("rerun", reason="the extra viewer is not installed")
    done = shell('"$@"', *REPLAY, JSON, "--rrd", "/dev/full", status=1)
    assert done.stderr.endswith("--rrd /dev/full: could not be written, and is not whole\n")


# --- named pipes and odd files


@pytest.fixture
def pipe(tmp_path):
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    return path


@pytest.mark.parametrize("verb", [("replay", TAKEOFF, "--csv"), ("tune", "sim:", "-o")])
def test_an_output_that_nobody_reads_is_refused(verb, pipe, refused):
    output = refused(*verb, pipe)
    assert output.endswith(f"{pipe}: a pipe that nobody reads, start its reader first")


def test_an_output_that_somebody_reads_is_written_whole(pipe, tmp_path):
    read = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()), daemon=True)
    reader.start()
    descriptor = os.open(pipe, os.O_WRONLY)  # waits until the reader is there
    assert main(["replay", str(TAKEOFF), "--csv", str(pipe)]) == 0
    os.close(descriptor)
    reader.join()
    assert main(["replay", str(TAKEOFF), "--csv", str(tmp_path / "file.csv")]) == 0
    assert read == [(tmp_path / "file.csv").read_bytes()]


def test_a_drawing_needs_a_file(pipe, refused):
    pytest.importorskip("rerun")
    line = refused("replay", TAKEOFF, "--rrd", pipe)
    assert line == f"fuzzbee: --rrd {pipe}: a pipe, choose a file"


@pytest.mark.skipif(not KERNEL_LOG.exists(), reason="no such file here")
@pytest.mark.parametrize("verb", [("replay",), ("check",), ("calibrate",), ("profile", "check")])
def test_a_file_of_the_kernel_is_empty(verb):
    assert main([*verb, str(KERNEL_LOG)]) == 2


def test_a_key_that_nobody_writes_into_its_pipe_is_empty(pipe, monkeypatch, refused):
    monkeypatch.setattr(security, "PIPE_S", 0.2)
    run = ("run", f"udpin:127.0.0.1:{free_port()}", "--no-zenoh", "--seconds=0.1")
    assert refused(*run, f"--signing-key-file={pipe}") == f"fuzzbee: the key file {pipe} is empty"


def test_a_key_may_come_by_a_pipe_in_pieces(pipe):
    def write():
        with pipe.open("wb", buffering=0) as file:
            file.write(b"a pass phrase ")
            file.write(b"in pieces")

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    assert security.key_of(pipe, is_insecure=False) == signing_key(b"a pass phrase in pieces")
    writer.join(60.0)
