"""``replay --retune`` and ``run --retune`` from the command line."""

import json
from pathlib import Path

import pytest

from estimator.errors import InputError
from fuzzbee.cli import main
from fuzzbee.replays.command import replay

LOG = Path(__file__).resolve().parents[1] / "data" / "px4_hover.ulg"


def test_a_flight_in_which_no_noise_changes_is_replayed_to_the_same_digit(capsys):
    plain, retuned = (_report(capsys, *options) for options in ((), ("--retune",)))
    assert "retuned" not in plain
    assert retuned.pop("retuned") == {"count": 0, "changes": []}
    for report in (plain, retuned):
        report.pop("wall_s")
    assert retuned == plain


def _report(capsys, *options):
    assert main(["replay", str(LOG), "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_papers_experiment_is_too_short():
    with pytest.raises(InputError, match="--retune is for logs"):
        replay(["sim:"], retune=True)
