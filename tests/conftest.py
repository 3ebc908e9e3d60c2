"""Settings that all tests share."""

import logging
import os
from collections.abc import Iterator

import pytest
from hypothesis import settings

# The same examples on every run, and no deadline: the first call of a kernel compiles it. Plain
# Python is there to stop at 0/0, which the first examples are.
settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    database=None,
    max_examples=10 if os.environ.get("NUMBA_DISABLE_JIT") == "1" else 40,
)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def logs_left_alone() -> Iterator[None]:
    """`run` in this process turns the drivers' log to its view; the next test has it as before."""
    loggers = [logging.getLogger(name) for name in ("drivers", "drivers.mavlink.link")]
    before = [(one.handlers[:], one.propagate, one.level) for one in loggers]
    yield
    for one, (handlers, propagate, level) in zip(loggers, before, strict=True):
        one.handlers, one.propagate = handlers, propagate
        one.setLevel(level)
