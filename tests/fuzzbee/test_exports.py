"""CSV, MCAP and figures of a replay: complete, readable, and the same twice."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from fuzzbee.cli import main
from fuzzbee.replays.exports import ATTITUDE_COLUMNS, COLUMNS
from fuzzbee.replays.simulation_files import COLUMNS as SIMULATION_COLUMNS

LOG = Path(__file__).parent.parent / "data" / "sitl_copter_4hz.tlog"


def replay(capsys, *arguments):
    status = main(["replay", *map(str, arguments)])
    out, err = capsys.readouterr()
    return status, out, err


def test_csv_holds_every_sample_with_its_reference(capsys, tmp_path):
    _, out, _ = replay(capsys, LOG, "--csv", tmp_path / "a.csv", "--json")
    report = json.loads(out)
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == report["imu"]["samples"]
    assert float(rows[-1]["time_s"]) == pytest.approx(report["duration_s"])
    compared = [float(r["error_inclination_deg"]) for r in rows if r["error_inclination_deg"]]
    squares = sum(e * e for e in compared) / len(compared)
    assert squares**0.5 == pytest.approx(report["error_deg"]["inclination_rms"], rel=1e-6)


def test_mcap_holds_the_same_and_is_read_by_the_library(capsys, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason="the extra 'mcap' is not installed")
    _, out, _ = replay(capsys, LOG, "--mcap", tmp_path / "a.mcap", "--json")
    with (tmp_path / "a.mcap").open("rb") as file:
        messages = [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in reader.make_reader(file).iter_messages()
        ]
    attitudes = [m for m in messages if m[0] == "/attitude"]
    assert len(attitudes) == json.loads(out)["imu"]["samples"]
    assert set(attitudes[0][2]) == set(ATTITUDE_COLUMNS)
    assert attitudes[-1][1] == pytest.approx(1e9 * attitudes[-1][2]["time_s"])
    assert any(m[0] == "/reference" for m in messages)


@pytest.mark.parametrize("suffix", ["csv", "mcap", "png", "svg", "pdf"])
def test_the_same_replay_twice_gives_the_same_bytes(capsys, tmp_path, suffix):
    pytest.importorskip("mcap" if suffix == "mcap" else "csv")
    if suffix in ("png", "svg", "pdf"):
        pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    option = "--plot" if suffix in ("png", "svg", "pdf") else f"--{suffix}"
    files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for file in files:
        assert replay(capsys, LOG, option, file, "--json")[0] == 0
    first, second = (file.read_bytes() for file in files)
    assert len(first) > 1000
    assert first == second


def test_csv_of_the_experiment_gives_its_cost_and_its_settling(capsys, tmp_path):
    """Every sample of every seed: the reported figures come out of the file again."""
    file = tmp_path / "a.csv"
    _, out, _ = replay(capsys, "sim:", "--seeds", "300-302", "--csv", file, "--json")
    report = json.loads(out)
    with file.open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert tuple(rows[0]) == SIMULATION_COLUMNS
    assert len(rows) == report["imu"]["samples"]
    e = np.array([float(row["error"]) for row in rows]).reshape(3, -1)
    J = 0.3 * e[:, :101].sum(axis=1) + e[:, 400:1401].sum(axis=1)
    assert J.tolist() == pytest.approx(report["cost_per_seed"], rel=1e-6)
    assert np.median(np.argmax(e < 0.01, axis=1)) / 100.0 == pytest.approx(report["settling_s"])
    total = np.radians([float(row["error_total_deg"]) for row in rows])
    assert np.sin(total / 2.0) ** 2 == pytest.approx(e.ravel(), abs=1e-8)
    gains = [float(row["gain"]) for row in rows]
    assert np.mean(gains) == pytest.approx(report["mean_gain"], rel=1e-6)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_papers_figures_are_drawn_the_same_twice(capsys, tmp_path, suffix):
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    files = [tmp_path / f"{name}.{suffix}" for name in "ab"]
    for file in files:
        arguments = ("sim:", "--profile", "adaptive", "--seeds", "300-303", "--plot", file)
        assert replay(capsys, *arguments, "--json")[0] == 0
    first, second = (file.read_bytes() for file in files)
    assert len(first) > 10_000
    assert first == second


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ((LOG, LOG, "--csv", "a.csv"), "takes one log"),
        ((LOG, "--plot", "a.jpeg"), ".png, .svg, .pdf"),
        ((LOG, "--csv", "missing/a.csv"), "missing"),
        (("sim:", "--mcap", "a.mcap"), "is for logs"),
        (("sim:", "--plot", "a.jpeg"), ".png, .svg, .pdf"),
        (("sim:", "--csv", "missing/a.csv"), "missing"),
    ],
)
def test_what_cannot_be_written_is_one_line(capsys, tmp_path, monkeypatch, arguments, expected):
    monkeypatch.chdir(tmp_path)
    status, out, err = replay(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert expected in err
    assert err.count("\n") == 1
