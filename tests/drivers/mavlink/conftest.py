"""Tests of links end with the threads and descriptors that they began with."""

import threading
import time
from pathlib import Path

import pytest

from drivers.mavlink.constants import mavlink
from tests.drivers.mavlink.links import PATIENCE_S


@pytest.fixture
def nothing_leaks():
    """Every test ends with the threads and file descriptors it began with."""
    mavlink()  # the dialect is loaded once
    descriptors = open_descriptors()
    threads = threading.active_count()
    yield
    # a thread's work is done a moment before the thread is
    end_s = time.monotonic() + PATIENCE_S
    while threading.active_count() > threads and time.monotonic() < end_s:
        time.sleep(0.01)
    assert threading.active_count() == threads
    assert open_descriptors() == descriptors


def open_descriptors():
    folder = Path("/proc/self/fd")
    return len(list(folder.iterdir())) if folder.is_dir() else 0
