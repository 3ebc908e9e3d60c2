"""``--from`` and ``--to``: a part of a log, by seconds or by arming."""

import csv
import tomllib

import numpy as np
import pytest

from fuzzbee import replay
from fuzzbee.cli import main
from tests.drivers.logs.writers import DataflashWriter
from tests.fuzzbee.recording import DATA, PLANE, TAKEOFF, rewritten, with_wrong_attitudes

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
    all_s, part_s = (
        np.array([float(row["time_s"]) for row in csv.DictReader(file.read_text().splitlines())])
        for file in (whole, part)
    )
    within = all_s[(all_s >= BEGIN_S) & (all_s <= END_S)]
    assert part_s == pytest.approx(within, abs=1e-6)
    assert report["window_s"] == pytest.approx([within[0], within[-1]])
    assert report["duration_s"] == pytest.approx(within[-1] - within[0])
    assert report["imu"]["samples"] == len(within)


def test_from_arming_to_disarming(replayed, tmp_path):
    """A heartbeat a second; a log that begins in flight is armed from its beginning."""
    for first_s in (BEGIN_S, 0.0):
        log = armed_between(TAKEOFF, tmp_path / "armed.tlog", first_s, END_S)
        begin_s, end_s = replayed(log, "--from", "arm", "--to", "disarm")["window_s"]
        assert (begin_s, end_s) == pytest.approx((first_s, END_S), abs=1.2)
        after = replayed(log, "--from", "disarm")["window_s"]
        assert after[0] == pytest.approx(end_s, abs=0.1)
        if first_s:
            assert replayed(log, "--to", "arm")["window_s"] == pytest.approx([0, begin_s], abs=0.1)


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


def test_check_looks_at_that_part(tmp_path, printed, capfd):
    wrong = with_wrong_attitudes(TAKEOFF, tmp_path / "wrong.tlog")
    assert "no difference" in printed("check", wrong, "--to", "1")
    assert main(["check", str(wrong), "--from", "1e4"]) == 2
    assert "the log lasts" in capfd.readouterr().out


def test_calibrate_uses_that_part(reported):
    whole, part = (reported("calibrate", PLANE, *window) for window in ((), ("--from", 60)))
    assert part["readings"] < whole["readings"]


def test_a_tuned_profile_names_its_part(tmp_path):
    tuned = tmp_path / "tuned.toml"
    budget = ("--sources", "2", "--cycles", "1", "--parameters", "gain", "--force")
    arguments = ("tune", PLANE, "-o", tuned, "--from", "20", "--to", "150", *budget)
    assert main([*map(str, arguments)]) == 0
    options = tomllib.loads(tuned.read_text())["provenance"]["options"]
    assert (options["from"], options["to"]) == (20.0, 150.0)


def test_a_log_that_was_never_armed(tmp_path, refused):
    log = armed_between(TAKEOFF, tmp_path / "idle.tlog", 1e6, 1e6)
    assert refused("replay", log, "--from", "arm") == f"fuzzbee: {log}: the vehicle was never armed"
