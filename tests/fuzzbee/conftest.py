"""The command as a person sees it: what it prints, and the one line with which it refuses."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from fuzzbee.cli import main


@pytest.fixture
def printed(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a command prints that ends well."""

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
    """The report of a replay."""
    return lambda *arguments: reported("replay", *arguments)


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """The one line with which a command ends, which prints nothing else and no traceback."""

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
