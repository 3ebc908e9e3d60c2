"""``fuzzbee tune sim:`` from the command line to the file."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer

from estimator.errors import InputError
from estimator.profile import load_profile, merge_profile, profile_to_toml
from fuzzbee.tune import searches
from fuzzbee.tune.command import tune
from tuning.checkpoint import write_checkpoint
from tuning.paper_experiment import run_experiment
from tuning.search import Record

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = ["sim:", "--sources", "6", "--cycles", "4", "--noise-seeds", "100-101"]
SMALL += ["--held-out-seeds", "200"]


def command(*arguments):
    """The verb alone, as the command line calls it; its exit status."""
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(tune)
    status = typer.main.get_command(app).main(
        args=[str(a) for a in arguments], standalone_mode=False
    )
    return status or 0


@pytest.fixture
def report(capsys):
    def parsed():
        return json.loads(capsys.readouterr().out)

    return parsed


def test_writes_a_profile_that_is_better_and_says_so(tmp_path, report):
    file = tmp_path / "tuned.toml"
    assert command(*SMALL, "-o", file, "--json") == 0
    said = report()
    assert said["evaluations"] == 6 * (1 + 2 * 4)
    assert said["cycles"] == 4
    assert said["food_sources"] == 6
    assert said["file"] == str(file)
    assert said["inputs"] == [{"name": "sim:"}]
    assert said["cost_after"] < said["cost_before"]
    tuned = load_profile(str(file))
    assert said["held_out_after"] == run_experiment(tuned, 200).cost
    assert said["wall_s"] > 0.0
    assert [p.name for p in tmp_path.iterdir()] == ["tuned.toml"]


def test_provenance_holds_what_determines_the_result(tmp_path, report):
    file = tmp_path / "tuned.toml"
    command(*SMALL, "-o", file, "--json", "--threads", "1")
    provenance = load_profile(str(file)).provenance
    assert provenance.options == {
        "command": "tune",
        "algorithm": "abc",
        "sources": 6,
        "cycles": 4,
        "parameters": "membership",
        "base": "midpoint",
        "limit": 132,
    }
    assert provenance.seeds == {"search": 0, "noise": "100-101", "held_out": "200"}
    assert str(tmp_path) not in file.read_text()


@pytest.mark.parametrize("algorithm", ["abc", "cmaes", "de"])
def test_the_same_options_give_the_same_file(tmp_path, algorithm):
    if algorithm == "cmaes":
        pytest.importorskip("cmaes")
    one, two = tmp_path / "one.toml", tmp_path / "two.toml"
    command(*SMALL, "--algorithm", algorithm, "-o", one)
    command(*SMALL, "--algorithm", algorithm, "-o", two, "--threads", "1")
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_and_resumed_is_the_same_file(tmp_path, number):
    """The signal goes to a real process once its first checkpoint period has begun."""
    options = [*SMALL[:1], "--sources", "40", "--cycles", "60", "--noise-seeds", "100-103"]
    options += ["--held-out-seeds", "200"]
    whole, broken = tmp_path / "whole.toml", tmp_path / "broken.toml"
    command(*options, "-o", whole)
    program = (
        "import sys, typer\n"
        "from fuzzbee.tune.command import tune\n"
        "import fuzzbee.tune.searches as searches\n"
        "show = searches.ProgressBar.show\n"
        "def told(bar, search):\n"
        "    show(bar, search)\n"
        "    print(search.evaluations, file=sys.stderr, flush=True)\n"
        "searches.ProgressBar.show = told\n"
        "typer.run(tune)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, *options, "-o", str(broken), "--json"],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        for line in process.stderr:
            if line.strip().isdecimal() and int(line) >= 1000:
                process.send_signal(number)
                break
        out, _ = process.communicate()
    said = json.loads(out)
    assert process.returncode == 130
    assert said["interrupted"]
    assert 1000 <= said["evaluations"] < 40 * 121
    assert "interrupted after" in load_profile(str(broken)).provenance.description
    assert (tmp_path / "broken.toml.checkpoint").exists()
    assert command(*options, "-o", broken, "--resume", "--threads", "1") == 0
    assert broken.read_bytes() == whole.read_bytes()
    assert not (tmp_path / "broken.toml.checkpoint").exists()


REFUSED = [
    (["--cycles", "0"], "--cycles 0"),
    (["--sources", "1"], "--sources 1"),
    (["--algorithm", "de", "--sources", "4"], "--sources 4"),
    (["--limit", "0"], "--limit 0"),
    (["--limit", "9", "--algorithm", "de"], "--limit"),
    (["--seed", "-1"], "--seed -1"),
    (["--threads", "0"], "--threads 0"),
    (["--threads", "2", "--cluster", "tcp://127.0.0.1:9"], "contradict"),
    (["--algorithm", "magic"], "--algorithm magic"),
    (["--noise-seeds", "107-100"], "empty"),
    (["--noise-seeds", "a-b"], "--noise-seeds a-b"),
    (["--noise-seeds", "5000-5003"], "kept for judging"),
    (["--held-out-seeds", "101-120"], "also in --noise-seeds"),
    (["--parameters", "confidence"], "membership"),
    (["--parameters", ","], "nothing to tune|membership"),
    (["--parameters", "membership,membership"], "given twice"),
    (["--base", "imu"], "raw vectors"),
    (["--base", "no-such-profile"], "no such file"),
    (["--resume"], "nothing to resume"),
    (["--plot", __file__], "not a folder"),
    (["--objective", "flight"], "goes with logs only"),
    (["--hold-out", __file__], "stands alone"),
]


@pytest.mark.parametrize(("options", "told"), REFUSED, ids=[" ".join(o) for o, _ in REFUSED])
def test_bad_options_are_refused_in_one_line(tmp_path, options, told):
    with pytest.raises(InputError, match=told) as error:
        command("sim:", "--noise-seeds", "100-101", "-o", tmp_path / "x.toml", *options)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_sim_stands_alone(tmp_path):
    with pytest.raises(InputError, match="stands alone"):
        command("sim:", "flight.tlog", "-o", tmp_path / "x.toml")


def test_the_output_must_be_writable(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        command(*SMALL, "-o", tmp_path / "none" / "x.toml")
    with pytest.raises(InputError, match="a folder"):
        command(*SMALL, "-o", tmp_path)


def test_resume_with_other_options_names_them(tmp_path):
    file = tmp_path / "x.toml"
    write_checkpoint(
        tmp_path / "x.toml.checkpoint", {"options": {}}, [Record(np.ones(2), "0" * 64)]
    )
    with pytest.raises(InputError, match=r"other options: .*options\.cycles"):
        command(*SMALL, "-o", file, "--resume")


def test_figures(tmp_path):
    pytest.importorskip("matplotlib")
    from matplotlib.image import imread

    folder = tmp_path / "figures"
    command(*SMALL, "-o", tmp_path / "x.toml", "--plot", folder)
    drawn = {path.name: imread(path) for path in folder.iterdir()}
    assert set(drawn) == {"convergence.png", "memberships.png", "error.png", "euler.png"}
    for picture in drawn.values():
        assert picture.shape[0] > 400
        assert picture[..., :3].std() > 0.05  # not a blank page


SLOW_LOG = Path(__file__).resolve().parents[1] / "data" / "sitl_copter_4hz.tlog"
FEW = ["--sources", "3", "--cycles", "2", "--threads", "1"]
EVALUATIONS = 3 * (1 + 2 * 2)


@pytest.fixture
def bad_base(tmp_path):
    """A profile that takes velocities for ten times as good as they are: whatever is found is
    better."""
    file = tmp_path / "bad.toml"
    bad = merge_profile(
        load_profile("imu"), {"aiding": {"filter_error_m_s": 0.02, "receiver_error_m_s": 0.015}}
    )
    file.write_text(profile_to_toml(bad))
    return file


def test_a_log_is_tuned_where_its_rate_allows(tmp_path, bad_base, capsys):
    file = tmp_path / "x.toml"
    assert command(SLOW_LOG, "-o", file, *FEW, "--base", bad_base, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["objective"] == "flight"
    assert said["parameters"] == ["noise"]
    assert said["reference"] == "simulator's truth"
    assert said["evaluations"] == EVALUATIONS
    assert said["file"] == str(file)
    assert said["cost_after"] < said["cost_before"]
    assert said["held_out_after"] < said["held_out_before"]
    assert said["random_search"]["cost"] < said["cost_before"]
    [flight] = said["held_out_flights"]
    assert said["harm"] is None
    assert flight["before"]["inclination"]["rms_deg"] > flight["after"]["inclination"]["rms_deg"]
    assert [(i["name"], i["use"]) for i in said["inputs"]] == [
        (SLOW_LOG.name, "its later part held out")
    ]
    tuned, base = load_profile(str(file)), load_profile(str(bad_base))
    assert tuned.membership == base.membership
    assert tuned.aiding != base.aiding
    assert tuned.provenance.inputs == said["inputs"]
    assert tuned.provenance.seeds == {"search": 0}


def test_what_gains_nothing_is_not_written_unless_forced(tmp_path, capsys):
    """K alone is worth less than 0.1 % of this cost, as it only follows conditioned vectors."""
    file = tmp_path / "x.toml"
    few = [*FEW, "--parameters", "gain", "--json"]
    assert command(SLOW_LOG, "-o", file, *few) == 1
    printed = capsys.readouterr()
    said = json.loads(printed.out)
    assert said["file"] is None
    assert said["held_out_after"] > 0.99 * said["held_out_before"]
    assert "nothing gained on what was held out" in printed.err
    assert not list(tmp_path.iterdir())
    assert command(SLOW_LOG, "-o", file, *few, "--force") == 0
    assert json.loads(capsys.readouterr().out)["file"] == str(file)
    assert load_profile(str(file)).provenance.options["parameters"] == "gain"


def test_a_log_that_is_held_out_is_not_searched_on(tmp_path, bad_base, capsys):
    other = tmp_path / "other.tlog"
    other.write_bytes(SLOW_LOG.read_bytes()[:-100_000])
    options = ["--hold-out", other, "-o", tmp_path / "x.toml", "--base", bad_base, "--force"]
    assert command(SLOW_LOG, other, *options, *FEW, "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert [(i["name"], i["use"]) for i in said["inputs"]] == [
        (SLOW_LOG.name, "tuned on"),
        ("other.tlog", "held out"),
    ]
    assert [flight["name"] for flight in said["held_out_flights"]] == ["other.tlog"]


def test_recovery_has_the_papers_cost(tmp_path, capsys):
    options = ["--objective", "recovery", "--force", "--sources", "2", "--cycles", "1"]
    assert command(SLOW_LOG, "-o", tmp_path / "x.toml", *options, "--json", "--threads", "1") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["parameters"] == ["confidence", "conditioning"]
    assert said["cost_before"] > 3.0  # J of 170 deg at 4 Hz


def test_what_moves_sigma_alone_is_judged_by_coverage(tmp_path, capsys):
    options = ["--objective", "coverage", "--reference", "smooth", "--force", "--json"]
    assert command(SLOW_LOG, "-o", tmp_path / "x.toml", *FEW, *options) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["parameters"] == ["sigma"]
    assert said["reference"] == "attitude smoothed over the whole log"
    [flight] = said["held_out_flights"]
    for angle in ("inclination", "heading"):
        before, after = flight["before"][angle], flight["after"][angle]
        assert after["rms_deg"] == pytest.approx(before["rms_deg"], rel=1e-3)
        assert after["coverage"] != before["coverage"]
    shares = [flight["after"][angle]["coverage"] for angle in ("inclination", "heading")]
    assert said["held_out_after"] == pytest.approx(np.mean(np.abs(np.array(shares) - 0.68)))
    assert said["cost_after"] < said["cost_before"]


def test_smoothed_references_are_crossed_and_a_search_goes_on_from_anywhere(tmp_path, monkeypatch):
    """A checkpoint after each batch: of both halves, and of the search over the crossed whole."""
    saved = []

    def keep(path, identity, records):
        write_checkpoint(path, identity, records)
        saved.append((len(records), path.read_bytes()))

    monkeypatch.setattr(searches, "CHECKPOINT_PERIOD_S", 0.0)
    monkeypatch.setattr(searches, "write_checkpoint", keep)
    one, other = tmp_path / "one.toml", tmp_path / "other.toml"
    few = ["--reference", "smooth", "--force", "--sources", "2", "--cycles", "1", "--threads", "1"]
    command(SLOW_LOG, "-o", one, *few)
    assert [stages for stages, _ in saved] == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    (tmp_path / "other.toml.checkpoint").write_bytes(saved[4][1])
    command(SLOW_LOG, "-o", other, *few, "--resume")
    assert other.read_bytes() == one.read_bytes()


def test_figures_of_a_log(tmp_path):
    pytest.importorskip("matplotlib")
    folder = tmp_path / "figures"
    command(SLOW_LOG, "-o", tmp_path / "x.toml", *FEW, "--plot", folder, "--force")
    assert {path.name for path in folder.iterdir()} == {"convergence.png", "error.png"}


def test_a_log_gives_the_same_file_wherever_it_lies_and_whoever_computes(tmp_path):
    other = tmp_path / "moved"
    other.mkdir()
    (other / SLOW_LOG.name).write_bytes(SLOW_LOG.read_bytes())
    command(SLOW_LOG, "-o", tmp_path / "a.toml", *FEW, "--force")
    command(other / SLOW_LOG.name, "-o", tmp_path / "b.toml", *FEW[:-1], "2", "--force")
    assert (tmp_path / "a.toml").read_bytes() == (tmp_path / "b.toml").read_bytes()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--parameters", "membership"], "fuzzy controller is tuned from 10 Hz"),
        (["--objective", "speed"], "--objective speed"),
        (["--reference", "gut"], "--reference gut"),
        (["--parameters", "sigma"], "--objective coverage"),
        (["--parameters", "noise", "--objective", "coverage"], "--objective coverage"),
        (["--hold-out", "no-such.tlog"], "no such file"),
        (["--hold-out", str(SLOW_LOG)], "nothing is left to tune on"),
        (["--noise-seeds", "100-101"], "goes with sim: only"),
        (["--held-out-seeds", "1-2"], "goes with sim: only"),
        (["--base", "paper"], "conditioning.enabled"),
        ([str(SLOW_LOG)], "the same log"),
        (["no-such.tlog"], "no such file"),
    ],
)
def test_bad_options_with_a_log_are_refused_in_one_line(tmp_path, options, told):
    with pytest.raises(InputError, match=told) as error:
        command(SLOW_LOG, "-o", tmp_path / "x.toml", *FEW, *options)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_the_output_is_no_source(tmp_path):
    log = tmp_path / "flight.tlog"
    log.write_bytes(SLOW_LOG.read_bytes())
    with pytest.raises(InputError, match="is also"):
        command(log, "-o", log)
    assert log.read_bytes() == SLOW_LOG.read_bytes()
