"""What ``check`` reports of sensors: vibration as ArduPilot's VIBE, clipping, warnings."""

import json
from math import hypot, sqrt
from pathlib import Path

import numpy as np
import pytest

from drivers.mavlink.constants import mavlink
from fuzzbee.cli import main
from tests.fuzzbee.tlogs import rewritten, table

RATE_HZ, SECONDS, G = 400.0, 40.0, 9.80665
TONE_HZ, CORNER_HZ = 40.0, 5.0


def shaken(folder, amplitude_m_s2, rate_hz=RATE_HZ, clip_rad_s=np.inf, tone_hz=TONE_HZ):
    """A vehicle at rest that shakes along its y axis, and turns for a moment."""
    t = np.arange(0.0, SECONDS, 1.0 / rate_hz)
    rng = np.random.default_rng(3)
    gyr, acc = 0.01 * rng.normal(size=(len(t), 3)), 0.05 * rng.normal(size=(len(t), 3))
    acc[:, 2] -= G
    acc[:, 1] += amplitude_m_s2 * np.sin(2.0 * np.pi * tone_hz * t)
    gyr[:, 2] += 8.0 * np.sin(2.0 * np.pi * 0.5 * t) * (t > 20.0) * (t < 24.0)
    rows = np.column_stack([gyr.clip(-clip_rad_s, clip_rad_s), acc / G]).round(7)
    return table(folder / "shaken.csv", rate_hz, rows.tolist())


def checked(capsys, path):
    assert main(["check", str(path), "--json"]) == 0
    (log,) = json.loads(capsys.readouterr().out)["logs"]
    return log


@pytest.mark.parametrize(
    ("amplitude", "tone_hz", "verdict", "ripple"),
    [
        (5.0, TONE_HZ, "usual", 0.08),
        (55.0, TONE_HZ, "high", 0.08),
        (120.0, TONE_HZ, "too high", 0.08),
        (20.0, 8.0, "usual", 0.15),  # near the corner a tone counts less
    ],
)
def test_vibration_is_that_of_a_high_passed_tone(
    tmp_path, capsys, amplitude, tone_hz, verdict, ripple
):
    """A tone's root mean square behind a first-order high-pass is known; 2 Hz leave a ripple."""
    found = checked(capsys, shaken(tmp_path, amplitude, tone_hz=tone_hz))["vibration"]
    wanted = amplitude / sqrt(2.0) * tone_hz / hypot(tone_hz, CORNER_HZ)
    assert found["m_s2"][1] == pytest.approx(wanted, rel=ripple)
    assert found["m_s2"][0] < 0.1
    assert found["verdict"] == verdict


def test_a_slow_stream_shows_no_vibration(tmp_path, capsys):
    assert checked(capsys, shaken(tmp_path, 5.0, rate_hz=10.0))["vibration"] is None


def test_the_line_names_limits_and_clipping(tmp_path, capsys):
    path = shaken(tmp_path, 55.0, clip_rad_s=5.0)
    assert checked(capsys, path)["clipped"]["gyroscope"] > 10
    assert main(["check", str(path)]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    for words in ("vibration high, ", "usual: under 30, a problem: over 60", "gyroscope clipped "):
        assert words in line


TAKEOFF = Path(__file__).parents[1] / "data" / "sitl_copter_takeoff.tlog"


def with_vibration(folder, autopilot=3, restarts=False):
    """A flight whose autopilot measures 12, 40 and 5 m/s^2, and clips ten times a second."""

    def change(seconds, message):
        if message.get_type() == "VIBRATION":
            return []
        if message.get_type() == "HEARTBEAT":
            message.autopilot = autopilot
            return [message]
        if message.get_type() != "RAW_IMU":
            return None
        since = seconds - 5.0 if restarts and seconds > 5.0 else seconds
        clips = 7 + int(10.0 * since)
        made = mavlink().MAVLink_vibration_message(0, 12.0, 40.0, 5.0, clips, 2, 0)
        return [message, made]

    return rewritten(TAKEOFF, folder / "flight.tlog", change)


def test_what_the_autopilot_has_measured_stands_beside_it(tmp_path, capsys):
    path = with_vibration(tmp_path)
    found = checked(capsys, path)["autopilot_vibration"]
    assert found["m_s2"] == [12.0, 40.0, 5.0]
    assert (found["message"], found["imu"], found["verdict"]) == ("VIBRATION", 0, "high")
    seconds = found["clipped"]["0"] / 10.0
    assert found["clipped"] == {"0": pytest.approx(10.0 * seconds), "1": 0, "2": 0}
    assert seconds > 20.0
    main(["check", str(path)])
    (line,) = capsys.readouterr().out.splitlines()
    assert "the autopilot's VIBRATION high, 40.0 m/s² (usual: under 30, a problem" in line
    assert f"VIBRATION counts: {found['clipped']['0']} by IMU 1 (usual: under 100)" in line

    assert main(["check", str(path), "--from", "4", "--to", "8", "--json"]) == 0
    (log,) = json.loads(capsys.readouterr().out)["logs"]
    assert log["autopilot_vibration"]["clipped"]["0"] == pytest.approx(40, abs=4)


def test_a_restart_sets_the_count_of_clipping_back(tmp_path, capsys):
    all_the_time = checked(capsys, with_vibration(tmp_path))["autopilot_vibration"]
    restarted = checked(capsys, with_vibration(tmp_path, restarts=True))["autopilot_vibration"]
    most = all_the_time["clipped"]["0"]
    assert restarted["clipped"]["0"] == pytest.approx(most + 7, abs=1)


def test_the_figures_of_px4_have_other_units(tmp_path, capsys):
    found = checked(capsys, with_vibration(tmp_path, autopilot=12))["autopilot_vibration"]
    assert (found["m_s2"], found["verdict"]) == (None, None)
    assert found["clipped"]["0"] > 100
