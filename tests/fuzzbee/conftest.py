"""What tests of the command share."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from fuzzbee.cli import main


@pytest.fixture
def replayed(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Replays by the command, and gives the report."""

    def run(*arguments: object) -> Any:
        assert main(["replay", *map(str, arguments), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return run
