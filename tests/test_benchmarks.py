"""Every benchmark starts, also without recordings and other filters, and prints its tables."""

import importlib
import json
import sys
from pathlib import Path

import pytest

from tests.programs import run_python

FOLDER = Path(__file__).parents[1] / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))

pytestmark = [pytest.mark.checkout, pytest.mark.slow]


def run(name, *arguments):
    script = str(FOLDER / f"{name}.py")
    done = run_python(script, *arguments, timeout_s=600, PYTHONWARNINGS="default")
    assert "Traceback" not in done.stderr
    return done.stdout


def numbers_in(value):
    """Every number of a table's cells, however deep."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [each for one in value for each in numbers_in(one)]
    return [value] if isinstance(value, int | float) else []


@pytest.fixture
def printed(name, monkeypatch, capsys):
    if name == "live":  # it ends with the processes that it has started
        return run(name, "--smoke", "--json")
    # in this process: to import everything anew takes longer than most of them
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--smoke", "--json"])
    assert importlib.import_module(name).main() in (None, 0)
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    return out


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_benchmark_runs(printed):
    found = json.loads(printed)
    tables = {title: rows for title, rows in found.items() if isinstance(rows, list)}
    assert tables
    for title, rows in tables.items():
        assert rows, title
        # a row without a number names what it lacks
        lacking = [row for row in rows if not numbers_in(row) and "not installed" not in str(row)]
        assert not lacking, title


def test_a_table_is_for_people():
    """Columns under their names, each row with as many cells."""
    assert len(SCRIPTS) > 10
    title, head, *rows = run("speed", "--smoke").strip().splitlines()
    assert title.startswith("time a sample")
    assert head.split()[:2] == ["way", "filter"]
    assert [row.split()[:2] for row in rows][:1] == [["batch", "fuzzbee"]]
