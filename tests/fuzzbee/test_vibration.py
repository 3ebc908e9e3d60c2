"""What ``check`` reports of sensors: vibration as ArduPilot's VIBE, clipping, warnings."""

import json
from math import hypot, sqrt

import numpy as np
import pytest

from fuzzbee.cli import main

RATE_HZ, SECONDS, G = 400.0, 40.0, 9.80665
TONE_HZ, CORNER_HZ = 40.0, 5.0


def table(folder, amplitude_m_s2, rate_hz=RATE_HZ, clip_rad_s=np.inf, tone_hz=TONE_HZ):
    """A vehicle at rest that shakes along its y axis, and turns for a moment."""
    t = np.arange(0.0, SECONDS, 1.0 / rate_hz)
    rng = np.random.default_rng(3)
    gyr, acc = 0.01 * rng.normal(size=(len(t), 3)), 0.05 * rng.normal(size=(len(t), 3))
    acc[:, 2] -= G
    acc[:, 1] += amplitude_m_s2 * np.sin(2.0 * np.pi * tone_hz * t)
    gyr[:, 2] += 8.0 * np.sin(2.0 * np.pi * 0.5 * t) * (t > 20.0) * (t < 24.0)
    gyr = gyr.clip(-clip_rad_s, clip_rad_s)
    path = folder / "shaken.csv"
    axes = [f"gyro_{axis} (rad/s)" for axis in "xyz"] + [f"acc_{axis} [m/s^2]" for axis in "xyz"]
    columns = ",".join(["time_s", *axes])
    rows = np.column_stack([t, gyr, acc])
    np.savetxt(path, rows, delimiter=",", header=columns, comments="", fmt="%.6f")
    return path


def checked(capsys, path):
    assert main(["check", str(path), "--json"]) == 0
    (log,) = json.loads(capsys.readouterr().out)["logs"]
    return log


@pytest.mark.parametrize(
    ("amplitude", "verdict"), [(5.0, "usual"), (55.0, "high"), (120.0, "too high")]
)
def test_vibration_is_that_of_a_high_passed_tone(tmp_path, capsys, amplitude, verdict):
    """A tone's root mean square behind a first-order high-pass is known."""
    found = checked(capsys, table(tmp_path, amplitude))["vibration"]
    wanted = amplitude / sqrt(2.0) * TONE_HZ / hypot(TONE_HZ, CORNER_HZ)
    assert found["m_s2"][1] == pytest.approx(wanted, rel=0.08)  # 2 Hz leave some ripple
    assert found["m_s2"][0] < 0.1
    assert found["verdict"] == verdict


def test_a_tone_near_the_corner_counts_less(tmp_path, capsys):
    found = checked(capsys, table(tmp_path, 20.0, tone_hz=8.0))["vibration"]
    wanted = 20.0 / sqrt(2.0) * 8.0 / hypot(8.0, CORNER_HZ)
    assert found["m_s2"][1] == pytest.approx(wanted, rel=0.15)  # 2 Hz leave more ripple


def test_a_slow_stream_shows_no_vibration(tmp_path, capsys):
    assert checked(capsys, table(tmp_path, 5.0, rate_hz=10.0))["vibration"] is None


def test_the_line_names_limits_and_clipping(tmp_path, capsys):
    path = table(tmp_path, 55.0, clip_rad_s=5.0)
    assert checked(capsys, path)["clipped"]["gyroscope"] > 10
    assert main(["check", str(path)]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert "vibration high, " in line
    assert "usual: under 30, a problem: over 60" in line
    assert "gyroscope clipped " in line
