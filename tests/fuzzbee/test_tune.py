"""``fuzzbee tune sim:`` from the command line to the file."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from estimator.profile import load_profile, merge_profile, profile_to_toml
from fuzzbee.cli import main
from fuzzbee.tune.report import has_gained, remarks
from tests.fuzzbee.recording import DATA, SLOW, bench, truth_of
from tuning.paper_experiment import run_experiment

SMALL = ["sim:", "--sources", "6", "--cycles", "4", "--noise-seeds", "100-101"]
SMALL += ["--held-out-seeds", "200"]
FEW = ["--sources", "3", "--cycles", "2", "--threads", "1"]


@pytest.fixture
def tuned(capsys, tmp_path):
    """The JSON of a command, which ends as it should, and what it prints beside it."""

    def run(*arguments, status=0):
        command = ("tune", *arguments, "-o", tmp_path / "x.toml", "--json")
        assert main([*map(str, command)]) == status
        out, err = capsys.readouterr()
        return json.loads(out), err

    return run


def require_figure(folder):
    """Of one file, which is not a blank page."""
    from matplotlib.image import imread

    (file,) = folder.iterdir()
    picture = imread(file)
    assert file.name == "tuning.png"
    assert picture.shape[0] > 400
    assert picture[..., :3].std() > 0.05


def test_writes_a_profile_that_is_better_and_says_so(tmp_path, tuned):
    """Its provenance holds what determines the result, and nothing else."""
    file = tmp_path / "x.toml"
    answer, _ = tuned(*SMALL, "--threads", "1", "--plot", tmp_path / "figures")
    require_figure(tmp_path / "figures")
    counts = {name: answer[name] for name in ("evaluations", "cycles", "food_sources")}
    assert counts == {"evaluations": 6 * (1 + 2 * 4), "cycles": 4, "food_sources": 6}
    assert answer["file"] == str(file)
    assert answer["inputs"] == [{"name": "sim:"}]
    assert answer["cost_after"] < answer["cost_before"]
    found = load_profile(str(file))
    assert answer["held_out_after"] == run_experiment(found, 200).cost
    assert answer["wall_s"] > 0.0
    assert {each.name for each in tmp_path.iterdir()} == {"x.toml", "figures"}
    assert found.provenance.options == {
        "command": "tune", "algorithm": "abc", "sources": 6, "cycles": 4,
        "parameters": "membership", "base": "midpoint", "limit": 132,
    }  # fmt: skip
    assert found.provenance.seeds == {"search": 0, "noise": "100-101", "held_out": "200"}
    assert str(tmp_path) not in file.read_text()


REFUSED_OF_SIM = [
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
    (["flight.tlog"], "stands alone"),
]
REFUSED_OF_A_LOG = [
    (["--parameters", "membership"], "fuzzy controller is tuned from 10 Hz"),
    (["--objective", "speed"], "--objective speed"),
    (["--reference", "gut"], "--reference gut"),
    (["--parameters", "sigma"], "--objective coverage"),
    (["--parameters", "noise", "--objective", "coverage"], "--objective coverage"),
    (["--hold-out", "no-such.tlog"], "no such file"),
    (["--hold-out", str(SLOW)], "nothing is left to tune on"),
    (["--noise-seeds", "100-101"], "goes with sim: only"),
    (["--held-out-seeds", "1-2"], "goes with sim: only"),
    (["--base", "paper"], "conditioning.enabled"),
    (["--parameters", "calibration", "--reference", "smooth"], "--reference smooth"),
    ([str(SLOW)], "the same log"),
    (["no-such.tlog"], "no such file"),
    ([str(DATA / "px4_hover.ulg")], "px4_hover.ulg: .*at least 60 s"),
    ([str(DATA / "copter_reboot.tlog")], "copter_reboot.tlog: .*no motion"),
]
REFUSED = [
    *((["sim:", "--noise-seeds", "100-101", *options], words) for options, words in REFUSED_OF_SIM),
    *(([SLOW, *FEW, *options], words) for options, words in REFUSED_OF_A_LOG),
]


@pytest.mark.parametrize(("options", "words"), REFUSED)
def test_bad_options_are_refused_in_one_line_and_leave_nothing(tmp_path, refused, options, words):
    assert re.search(words, refused("tune", *options, "-o", tmp_path / "x.toml"))
    assert not list(tmp_path.iterdir())


def checkpoint(schema=3, evaluations=1, asked="ab", identity=None, costs=b"\0" * 8):
    header = {"schema": schema, "evaluations": evaluations, "asked_sha256": asked}
    return json.dumps({**header, "identity": identity or {"options": {}}}).encode() + b"\n" + costs


DEEP = b'{"schema":3,"evaluations":1,"asked_sha256":"","identity":'
CHECKPOINTS = [
    (checkpoint(), r"other options: .*options\.cycles"),
    (checkpoint(costs=b""), "damaged"),
    (checkpoint(schema=2), "another version"),
    (b"", "not a checkpoint"),
    (b"\x00\xff", "not a checkpoint"),
    (b"[1]\n", "not a checkpoint"),
    (b"[" * 100_000, "not a checkpoint"),
    (b"9" * 5000, "not a checkpoint"),
    (DEEP + b'{"a":' * 900 + b"1" + b"}" * 900 + b"}\n", "not a checkpoint|damaged"),
    *((checkpoint(evaluations=n), "not a checkpoint|damaged") for n in (-1, 1.5, "3", [3], None)),
]


@pytest.mark.parametrize(("content", "words"), [*CHECKPOINTS, (None, "not a checkpoint")])
def test_a_checkpoint_of_something_else_is_refused_in_one_line(tmp_path, refused, content, words):
    """Nor is a pipe waited for."""
    file = tmp_path / "x.toml.checkpoint"
    os.mkfifo(file) if content is None else file.write_bytes(content)
    line = refused("tune", *SMALL, "-o", tmp_path / "x.toml", "--resume")
    assert re.search(words, line)
    assert len(line) < 500
    assert [*tmp_path.iterdir()] == [file]


@pytest.fixture
def bad_base(tmp_path):
    """A profile that takes velocities for ten times as good as they are."""
    file, errors = tmp_path / "bad.toml", {"filter_error_m_s": 0.02, "receiver_error_m_s": 0.015}
    sure = {**errors, "filter_noise_m_s": 0.005, "receiver_noise_m_s": 0.01}
    file.write_text(profile_to_toml(merge_profile(load_profile("imu"), {"aiding": sure})))
    return file


def uses(answer):
    return [(each["name"], each["use"]) for each in answer["inputs"]]


def test_a_log_is_tuned_where_its_rate_allows(tmp_path, bad_base, tuned):
    file = tmp_path / "x.toml"
    answer, _ = tuned(SLOW, *FEW, "--base", bad_base, "--plot", tmp_path / "figures")
    require_figure(tmp_path / "figures")
    assert (answer["objective"], answer["parameters"]) == ("flight", ["noise"])
    assert answer["reference"] == "simulator's truth"
    assert (answer["evaluations"], answer["file"]) == (3 * (1 + 2 * 2), str(file))
    assert answer["cost_after"] < answer["cost_before"]
    assert answer["held_out_after"] < answer["held_out_before"]
    assert answer["random_search"]["cost"] < answer["cost_before"]
    [flight] = answer["held_out_flights"]
    assert answer["harm"] is None
    assert flight["before"]["inclination"]["rms_deg"] > flight["after"]["inclination"]["rms_deg"]
    assert uses(answer) == [(SLOW.name, "its later part held out")]
    found, base = load_profile(str(file)), load_profile(str(bad_base))
    assert found.membership == base.membership
    assert found.aiding != base.aiding
    assert found.provenance.inputs == answer["inputs"]
    assert found.provenance.seeds == {"search": 0}


def test_what_gains_nothing_is_not_written_unless_forced(tmp_path, tuned):
    """K counts for little where it only follows conditioned vectors."""
    file, few = tmp_path / "x.toml", [SLOW, *FEW, "--parameters", "gain"]
    answer, printed = tuned(*few, status=1)
    assert answer["file"] is None
    assert answer["held_out_after"] > 0.99 * answer["held_out_before"]
    assert "nothing gained on what was held out" in printed
    assert not list(tmp_path.iterdir())
    fuzzy = tmp_path / "fuzzy.toml"
    rules = {"filter": {"gain": "fuzzy"}}
    fuzzy.write_text(profile_to_toml(merge_profile(load_profile("imu"), rules)))
    assert tuned(*few, "--base", fuzzy, "--force")[0]["file"] == str(file)
    found = load_profile(str(file))
    assert found.filter.gain == "fixed"  # or the number that was tuned would have no effect
    assert found.provenance.options["parameters"] == "gain"


@pytest.mark.parametrize(
    ("after", "harm", "written", "line"),
    [
        (2.0, None, "x.toml", None),
        (2.17, "the error rises", None, "J falls from 2.3800 to 2.1700, but the error rises"),
        (2.5, "the error rises", None, "J rises from 2.3800 to 2.5000, and the error rises"),
        (2.37, None, None, "nothing gained on what was held out (J 2.3800 -> 2.3700, 1 % less"),
        (2.5, None, "x.toml", "nothing gained on what was held out (J 2.3800 -> 2.5000, 1 % less"),
    ],
)
def test_what_is_reported_of_a_result_is_one_story(after, harm, written, line):
    report = {"interrupted": False, "file": written, "harm": harm}
    report |= {"held_out_before": 2.38, "held_out_after": after}
    answer = [*remarks(Path("x.toml"), report, on_logs=True)]
    assert has_gained(2.38, after, harm) == (line is None)
    end = "is written all the same" if written else "is not written; --force writes it"
    are_whole = [line in each and each.endswith(f"x.toml {end}") for each in answer]
    assert are_whole == [True] * bool(line)


def test_a_log_that_is_held_out_is_not_searched_on(tmp_path, bad_base, tuned):
    other = tmp_path / "other.tlog"
    other.write_bytes(SLOW.read_bytes()[:-100_000])
    answer, _ = tuned(SLOW, other, "--hold-out", other, "--base", bad_base, "--force", *FEW)
    assert uses(answer) == [(SLOW.name, "tuned on"), ("other.tlog", "held out")]
    assert [flight["name"] for flight in answer["held_out_flights"]] == ["other.tlog"]


CALIBRATION = [*FEW, "--parameters", "calibration"]


def test_a_calibration_is_fitted_and_what_it_leaves_open_is_searched(tmp_path, tuned):
    logs = [bench(tmp_path / f"{k}.csv", k, seconds=80.0, errors=3) for k in (1, 2)]
    answer, _ = tuned(logs[0], "--hold-out", logs[1], *CALIBRATION, "--force")
    found = load_profile(tmp_path / "x.toml")
    for name in ("acc_bias_m_s2", "mag_offset_gauss"):
        assert getattr(found.calibration, name) == pytest.approx(truth_of(3)[name], abs=0.05)
    assert answer["parameters"] == ["calibration"]
    alone = answer["calibration_alone"]
    assert alone["held_out"] < 0.5 * answer["held_out_before"]
    assert answer["cost_after"] <= alone["cost"] < 0.5 * answer["cost_before"]
    assert found.provenance.options["base"] == "imu"
    assert [each["use"] for each in found.provenance.inputs] == ["tuned on", "held out"]


def test_recovery_has_the_papers_cost_and_a_profile_names_its_part_of_the_log(tmp_path, tuned):
    part = ("--from", "10", "--to", "140")
    answer, _ = tuned(SLOW, *FEW, "--objective", "recovery", *part, "--force")
    assert answer["parameters"] == ["confidence", "conditioning"]
    assert answer["cost_before"] > 3.0  # J of 170 deg at 4 Hz
    options = load_profile(tmp_path / "x.toml").provenance.options
    assert (options["from"], options["to"]) == (10.0, 140.0)


def test_what_moves_sigma_alone_is_judged_by_coverage(tuned):
    options = ["--objective", "coverage", "--reference", "smooth", "--force"]
    answer, _ = tuned(SLOW, *FEW, *options)
    assert answer["parameters"] == ["sigma"]
    assert answer["reference"] == "attitude smoothed over the whole log"
    [flight] = answer["held_out_flights"]
    for angle in ("inclination", "heading"):
        before, after = flight["before"][angle], flight["after"][angle]
        assert after["rms_deg"] == pytest.approx(before["rms_deg"], rel=1e-3)
        assert after["coverage"] != before["coverage"]
    shares = [flight["after"][angle]["coverage"] for angle in ("inclination", "heading")]
    assert answer["held_out_after"] == pytest.approx(np.mean(np.abs(np.array(shares) - 0.68)))
    assert answer["cost_after"] < answer["cost_before"]


def test_a_log_gives_the_same_file_in_any_folder_and_by_any_worker(tmp_path, tuned):
    moved = tmp_path / "moved" / SLOW.name
    moved.parent.mkdir()
    moved.write_bytes(SLOW.read_bytes())
    files = []
    for log, threads in ((SLOW, "1"), (moved, "2")):
        tuned(log, *FEW[:-1], threads, "--force")
        files.append((tmp_path / "x.toml").read_bytes())
    assert files[0] == files[1]
