"""Tests of links leave no threads and descriptors behind."""

import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from drivers.mavlink.constants import mavlink
from tests.drivers.mavlink.links import PATIENCE_S


@pytest.fixture
def nothing_leaks():
    """Every test ends without threads and descriptors that it did not begin with."""
    mavlink()  # the dialect is loaded once
    descriptors, threads = open_descriptors(), {*threading.enumerate()}
    yield
    # a thread's work is done a moment before the thread is
    end_s = time.monotonic() + PATIENCE_S
    while {*threading.enumerate()} - threads and time.monotonic() < end_s:
        time.sleep(0.01)
    # one that another test has left may end meanwhile
    assert not {*threading.enumerate()} - threads
    assert not open_descriptors() - descriptors


def open_descriptors():
    """Numbers, and what they stand for."""
    folder, found = Path("/proc/self/fd"), set()
    for each in folder.iterdir() if folder.is_dir() else ():
        with suppress(FileNotFoundError):  # that of the folder itself
            found.add((each.name, each.readlink()))
    return found
