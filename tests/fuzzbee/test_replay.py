"""``fuzzbee replay`` from the outside, and the parts of a log: one JSON object or one line out."""

import io
import sys
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from drivers.logs import csv_text, log_file
from drivers.logs.open import open_log
from fuzzbee import replay
from fuzzbee.cli import main
from fuzzbee.replays.table import reading_bar
from tests.drivers.logs.writers import DataflashWriter
from tests.fuzzbee.recording import DATA, TAKEOFF, rewritten, table

LOG_KEYS = {
    *("source", "vehicle", "imu", "duration_s", "reference", "error_deg", "coverage", "peers"),
    *("convergence_s", "mean_gain", "rejected", "wall_s"),
}
MORE_KEYS = {"heading_references", "constant_turn", "differences", "agreement"}
SIMULATION_KEYS = {"seeds", "cost", "cost_per_seed", "steady_state_error", "settling_s"}


# Of each recording the samples and the root mean square of the inclination's errors, deg.
RECORDINGS = {
    "copter_reboot.tlog": (457, 2.31),
    "px4_hover.ulg": (3219, 0.611),
    "rover_no_magnetometer.tlog": (238, 0.819),
    "sitl_copter_4hz.tlog": (600, 0.818),
    "sitl_copter_flips.tlog": (1000, 0.210),
    "sitl_copter_takeoff.tlog": (1745, 0.0980),
    "sitl_plane_4hz.tlog": (554, 0.806),
    "sub_bad_data.tlog": (100, 0.0403),
    "sub_bluerov.tlog": (121, 0.336),
    "sub_on_its_side.tlog": (84, 0.131),
}
# Arguments, and what the report has: numbers to 20 %, which were measured. On the plane a wrong
# start reaches the truth after 8.0 s, when the declination is known. At K = 0.01 the estimate
# cannot follow 1 rad/s.
ROVER = "rover_no_magnetometer.tlog"
FIGURES = {
    TAKEOFF.name: {"reference": "sim", "peers autopilot inclination_rms": 0.202},
    f"{TAKEOFF.name} --reference autopilot": {"reference": "autopilot", "peers": {}},
    ROVER: {"error_deg heading_rms": None, "coverage heading": None},
    "sub_on_its_side.tlog": {"heading_references": {"magnetic": 84}},  # no position
    f"{TAKEOFF.name} --start-wrong 170": {"convergence_s": 0.64},
    "sitl_copter_flips.tlog --start-wrong 170": {"convergence_s": 0.56},
    "sitl_plane_4hz.tlog --start-wrong 90": {"convergence_s": 2.98},
    f"{TAKEOFF.name} --smooth": {"error_deg inclination_rms": 0.111},
    # 10.6 deg with the field of the Gulf of Guinea, where the autopilot is before its fix
    "sitl_plane_4hz.tlog --skip 40": {"error_deg total_rms": 1.01, "coverage inclination": 0.949},
    "sub_bluerov.tlog --gain 7": {"mean_gain": 7.0},
    "sim: --seeds 3-5": {"cost": 6.23, "seeds": [3, 5]},
    "sim: --seeds 3-5 --gain 0.01": {"settling_s": None},
}


@pytest.mark.parametrize("log", [p.name for p in DATA.iterdir() if p.suffix != ".md"])
def test_every_recording_gives_one_object_with_the_whole_schema(replayed, log):
    report = replayed(DATA / log)
    samples, inclination_deg = RECORDINGS[log]
    assert set(report) == LOG_KEYS | MORE_KEYS
    assert report["imu"]["samples"] == samples
    assert report["error_deg"]["inclination_rms"] == pytest.approx(inclination_deg, rel=0.2)


@pytest.mark.parametrize("arguments", FIGURES)
def test_a_figure_is_what_was_measured(replayed, arguments):
    source, *options = arguments.split()
    report = replayed(source if source == "sim:" else DATA / source, *options)
    for keys, measured in FIGURES[arguments].items():
        found = reduce(dict.__getitem__, keys.split(), report)
        is_number = isinstance(measured, float)
        assert found == (pytest.approx(measured, rel=0.2) if is_number else measured), keys
    if source == "sim:":
        assert set(report) == LOG_KEYS | SIMULATION_KEYS
        assert report["cost"] == pytest.approx(sum(report["cost_per_seed"]) / 3)


def test_two_norths_in_a_comparison_are_named(printed):
    """Beside true north they leave the declination in the heading's error."""
    for log, is_magnetic in (("sub_on_its_side.tlog", True), (TAKEOFF.name, False)):
        words = " ".join(printed("replay", DATA / log, "--skip", 5).split())
        assert ("100 % of our headings are from magnetic north" in words) == is_magnetic


def test_several_profiles_and_logs_come_in_one_table_and_one_figure(replayed, capfd, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra 'plot' is not installed")
    logs = (DATA / "sub_bluerov.tlog", DATA / ROVER)
    profiles = ("--profile", "imu", "--profile", "adaptive")
    figure = tmp_path / "a.svg"
    replayed(logs[0], "--profile", "imu", "--profile", "imu", "--plot", figure)  # which are one
    figure.unlink()
    report = replayed(*logs, *profiles, "--plot", figure)
    names = [(Path(each["source"]).name, each["profile"]) for each in report["logs"]]
    assert names == [(log.name, name) for log in logs for name in ("imu", "adaptive")]
    errors = [each["error_deg"]["inclination_rms"] for each in report["logs"]]
    assert errors[:2] == pytest.approx([0.336, 19.1], rel=0.2)
    assert figure.stat().st_size > 10_000
    main(["replay", *map(str, logs), *profiles])
    out, lines = capfd.readouterr()
    of_logs = {line.partition(": ")[0] for line in lines.splitlines()}
    assert {f"{log} with {name}" for log, name in names} <= of_logs
    assert [out.count(word) for word in ("imu", "adaptive", "sub_bluerov")] == [2, 2, 2]
    assert "p95" in out  # the last column has its place


def test_a_recording_of_fuzzbee_s_own_vehicle_has_the_profile_that_fits(replayed, tmp_path):
    from drivers.mavlink.framing import FrameReader
    from drivers.mavlink.recorder import Recorder
    from drivers.simulation.autopilot import SimulatedAutopilot, VehicleOptions

    log = tmp_path / "own.tlog"
    data = SimulatedAutopilot(VehicleOptions(rate_hz=50.0, seed=3), 1).advance(12_000_000, 0)
    with Recorder(log) as recorder:
        for number, frame in enumerate(FrameReader().feed(data)):
            recorder.write(1_700_000_000_000_000 + 5_000 * number, [frame.data])
    report = replayed(log, "--skip", 3)
    assert 4 < report["error_deg"]["total_rms"] < 12
    assert 0.5 < report["coverage"]["heading"] < 0.9
    report = replayed(log, "--skip", 3, "--profile", "imu")
    assert report["error_deg"]["total_rms"] > 30


@pytest.mark.parametrize("name", ["px4_hover.ulg", "sub_bluerov.tlog", "table.csv"])
def test_a_terminal_shows_how_far_a_log_has_been_read(name, tmp_path, monkeypatch):
    rows = ((0.001, 0, 1e-6 * (k % 7), 0, 0, -1) for k in range(15_000))  # 400 kB
    path = table(tmp_path / name, 100.0, rows) if name == "table.csv" else DATA / name
    for each in (log_file, csv_text):
        monkeypatch.setattr(each, "READ_SIZE", 70_000)
    terminal, log, positions = io.StringIO(), open_log(path), []
    monkeypatch.setattr(terminal, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with reading_bar(log):
        show = log.on_read
        log.on_read = lambda done: (positions.append(done), show(done))
        assert sum(1 for _ in log) > 1000
    assert name in terminal.getvalue()
    assert max(positions) > 0.5 * log.path.stat().st_size


def test_elsewhere_nothing_is_shown(capsys):
    log = open_log(DATA / "px4_hover.ulg")
    with reading_bar(log):
        assert log.on_read is None
    assert capsys.readouterr() == ("", "")


# --- a part of a log, by seconds or by arming

ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
BEGIN_S, END_S = 4.0, 9.0


def armed_between(log, made, begin_s, end_s):
    """A telemetry log's copy whose autopilot is armed between those seconds of the stamps alone."""

    def change(seconds, message):
        if message.get_type() != "HEARTBEAT":
            return None
        message.base_mode = message.base_mode & ~ARMED | ARMED * (begin_s <= seconds < end_s)
        return [message]

    return rewritten(log, made, change)


def test_seconds_count_from_the_logs_beginning(replayed, tmp_path):
    whole, part = tmp_path / "whole.csv", tmp_path / "part.csv"
    replayed(TAKEOFF, "--csv", whole)
    report = replayed(TAKEOFF, "--from", BEGIN_S, "--to", END_S, "--csv", part)
    all_s, part_s = (np.loadtxt(f, delimiter=",", skiprows=1, usecols=0) for f in (whole, part))
    within = all_s[(all_s >= BEGIN_S) & (all_s <= END_S)]
    assert part_s == pytest.approx(within, abs=1e-6)
    assert report["window_s"] == pytest.approx([within[0], within[-1]])
    assert report["duration_s"] == pytest.approx(within[-1] - within[0])
    assert report["imu"]["samples"] == len(within)


def test_from_arming_to_disarming_if_it_was_ever_armed(replayed, tmp_path, refused):
    """A heartbeat a second; a log that begins in flight is armed from its beginning."""
    for first_s in (BEGIN_S, 0.0):
        log = armed_between(TAKEOFF, tmp_path / "armed.tlog", first_s, END_S)
        begin_s, end_s = replayed(log, "--from", "arm", "--to", "disarm")["window_s"]
        assert (begin_s, end_s) == pytest.approx((first_s, END_S), abs=1.2)
        assert replayed(log, "--from", "disarm")["window_s"][0] == pytest.approx(end_s, abs=0.1)
        if first_s:
            assert replayed(log, "--to", "arm")["window_s"] == pytest.approx([0, begin_s], abs=0.1)
    log = armed_between(TAKEOFF, tmp_path / "idle.tlog", 1e6, 1e6)
    assert refused("replay", log, "--from", "arm") == f"fuzzbee: {log}: the vehicle was never armed"


@pytest.mark.parametrize(
    ("name", "column", "words"), [("ARM", "ArmState", (1, 0)), ("EV", "Id", (10, 11))]
)
def test_dataflash_logs_report_arming(replayed, tmp_path, name, column, words):
    """Armed after 1 s, disarmed after 3 s."""
    writer = DataflashWriter()
    writer.format(name, "QB", f"TimeUS,{column}")
    writer.format("IMU", "QffffffB", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,I")
    reported = dict(zip((11_000_000, 13_000_000), words, strict=True))
    for k in range(400):
        us = 10_000_000 + 10_000 * k
        if us in reported:
            writer.write(name, us, reported[us])
        writer.write("IMU", us, 0.01 * np.sin(k), 0.01, 0.0, 0.1, 0.01 * np.cos(k), -9.8, 0)
    window = ("--from", "arm", "--to", "disarm")
    begin_s, end_s = replayed(writer.save(tmp_path), *window)["window_s"]
    assert (begin_s, end_s) == pytest.approx((1.0, 2.99), abs=0.011)


def test_px4_logs_report_arming_and_python_takes_a_part(replayed):
    """This one was armed in all of the clip."""
    begin_s, _ = replayed(DATA / "px4_hover.ulg", "--from", "arm")["window_s"]
    assert begin_s == pytest.approx(0.0, abs=0.1)
    times_s = replay(TAKEOFF, begin=BEGIN_S, end=END_S).attitudes.time_s
    assert [times_s[0], times_s[-1]] == pytest.approx([BEGIN_S, END_S], abs=0.3)
