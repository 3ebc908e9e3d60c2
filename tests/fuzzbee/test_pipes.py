"""Pipes and odd files as inputs and outputs: a line, never an endless wait."""

import os
import threading
from pathlib import Path

import pytest

from drivers.mavlink.encoder import signing_key
from fuzzbee import security
from fuzzbee.cli import main
from tests.fuzzbee.processes import free_port
from tests.fuzzbee.recording import TAKEOFF

KERNEL_LOG = Path("/proc/kmsg")  # a file by its mode, without a size; to read it blocks

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")


@pytest.fixture
def pipe(tmp_path):
    path = tmp_path / "pipe.csv"
    os.mkfifo(path)
    return path


@pytest.mark.parametrize(
    "verb", [("replay", str(TAKEOFF), "--csv"), ("tune", "sim:", "--sources=2", "--cycles=1", "-o")]
)
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
    line = refused(*run, f"--signing-key-file={pipe}")
    assert line == f"fuzzbee: the key file {pipe} is empty"


def test_a_key_may_come_by_a_pipe_in_pieces(pipe):
    def write():
        with pipe.open("wb", buffering=0) as file:
            file.write(b"a pass phrase ")
            file.write(b"in pieces")

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    assert security.key_of(pipe, is_insecure=False) == signing_key(b"a pass phrase in pieces")
    writer.join(60.0)
