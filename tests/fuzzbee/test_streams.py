"""Standard output and error as a shell redirects them: full, closed, or left by their reader."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzzbee.processes import shell
from tests.fuzzbee.recording import FLIPS

RUN = ("run", "sim:", "--no-zenoh", "--seconds", "1.5", "--profile", "paper")
REPLAY = ("replay", str(FLIPS))
CHECK = ("check", str(FLIPS))
JSON = "--json"
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
def test_output_that_cannot_be_written_is_a_line_and_a_reader_that_leaves_is_none(
    line, arguments, status, output
):
    done = shell(line, *arguments, status=status)
    assert output in done.stderr
    assert "Traceback" not in done.stderr
    assert "Broken" not in done.stderr
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
    program, file = tmp_path / "program.py", tmp_path / "recording"
    program.write_text(PRINTING)
    words = [program, sys.executable, file]
    line = ["sh", "-c", 'exec "$1" "$0" "$2" <&- >&- 2>&-', *map(str, words)]
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
