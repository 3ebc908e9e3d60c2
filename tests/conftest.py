"""Settings that all tests share, and the command as a person sees it."""

import json
import logging
import os
from collections.abc import Callable, Iterator
from typing import Any

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


@pytest.fixture
def printed(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a command prints that ends well."""
    from fuzzbee.cli import main

    def run(*arguments: object) -> str:
        capfd.readouterr()
        assert main([*map(str, arguments)]) == 0
        return capfd.readouterr().out

    return run


@pytest.fixture
def reported(printed: Callable[..., str]) -> Callable[..., Any]:
    """The object that it prints as JSON."""
    return lambda *arguments: json.loads(printed(*arguments, "--json"))


@pytest.fixture
def replayed(reported: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: reported("replay", *arguments)


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """The one line with which a command ends, which prints nothing else and no traceback."""
    from fuzzbee.cli import main

    def run(*arguments: object, status: int = 2) -> str:
        capfd.readouterr()
        assert main([*map(str, arguments)]) == status
        out, err = capfd.readouterr()
        assert out == ""
        (line,) = err.splitlines()
        assert line.startswith("fuzzbee: ")
        assert "Errno" not in line
        return line

    return run
