"""``fuzzbee calibrate``: iron put into a log is found again, and its profile takes it away."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from fuzzbee.cli import main
from tests.fuzzbee.iron import with_iron

DATA = Path(__file__).parent.parent / "data"
PLANE = DATA / "sitl_plane_4hz.tlog"
OFFSET_MGAUSS = (60.0, -40.0, 50.0)


def said(capsys, *arguments):
    assert main([*map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_a_profile_that_it_prints_gives_the_heading_back(tmp_path, capsys):
    """As recorded the heading is 1.66 deg off, with the iron 5.17, with the profile 1.66 (RMS)."""
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS)
    printed = said(capsys, "calibrate", log)
    found = 1e3 * np.array(tomllib.loads(printed)["mounting"]["mag_offset_gauss"])
    assert found == pytest.approx(OFFSET_MGAUSS, abs=2.0)  # mG; there are 1.3 without the iron
    assert "COMPASS_OFS_X -60." in printed
    (tmp_path / "mine.toml").write_text(printed)
    replays = [(PLANE, "imu"), (log, "imu"), (log, tmp_path / "mine.toml")]
    before, iron, after = (
        json.loads(said(capsys, "replay", each, "--profile", profile, "--json"))["error_deg"][
            "heading_rms"
        ]
        for each, profile in replays
    )
    assert after < 1.2 * before < 0.5 * iron


def test_what_the_current_adds_is_told_apart(tmp_path, capsys):
    """1.5, -2 and 1 mG for each of 10 to 30 A, and as ArduPilot's COMPASS_MOT what undoes it."""
    own = (1.5, -2.0, 1.0)
    log = with_iron(PLANE, tmp_path / "current.tlog", OFFSET_MGAUSS, current_mgauss_a=own)
    report = json.loads(said(capsys, "calibrate", log, "--json"))
    found, sigma = (1e3 * np.array(report[f"current_{each}gauss_a"]) for each in ("", "sigma_"))
    assert found == pytest.approx(own, abs=0.25)  # mG/A; it is 0.17 off
    assert (np.abs(found - own) < 3.0 * sigma).all()
    assert sigma.max() < 1.0
    usual = 1e3 * np.array(report["mounting"]["mag_offset_gauss"]) - 20.0 * np.array(own)
    assert report["matrix_sigma"] is None  # what it says more is by chance
    assert usual == pytest.approx(OFFSET_MGAUSS, abs=5.0)
    told = report["ardupilot"]
    offsets = [told[f"COMPASS_OFS_{axis}"] for axis in "XYZ"]
    assert offsets == pytest.approx([-each for each in OFFSET_MGAUSS], abs=5.0)
    assert told["COMPASS_MOTCT"] == 2
    assert [told[f"COMPASS_MOT_{axis}"] for axis in "XYZ"] == pytest.approx((-found).tolist())


TURNS = {
    "YAW_90": (2, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "ROLL_180": (8, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "YAW_180": (4, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("name", TURNS)
def test_a_compass_that_is_turned_is_turned_back(tmp_path, capsys, name):
    """By the plane's velocity; MAV_SENSOR_ORIENTATION has the numbers."""
    number, turn = TURNS[name]
    others = ("SCALED_IMU2", "SCALED_IMU3")
    log = with_iron(PLANE, tmp_path / "turned.tlog", OFFSET_MGAUSS, np.array(turn), left_out=others)
    report = json.loads(said(capsys, "calibrate", log, "--json"))
    assert report["orientation"] == name
    found = 1e3 * np.array(report["mounting"]["mag_offset_gauss"])
    assert found == pytest.approx(OFFSET_MGAUSS, abs=4.0)  # mG, in the axes of the readings
    assert report["ardupilot"] == {"COMPASS_ORIENT": number}
    printed = said(capsys, "calibrate", log)
    assert f"should be {name}" in printed
    (tmp_path / "mine.toml").write_text(printed)
    errors = [
        json.loads(said(capsys, "replay", each, "--profile", profile, "--json"))["error_deg"]
        for each, profile in ((PLANE, "imu"), (log, tmp_path / "mine.toml"))
    ]
    assert errors[1]["heading_rms"] < 1.2 * errors[0]["heading_rms"]


def test_a_compass_in_its_place_has_no_other(capsys):
    assert json.loads(said(capsys, "calibrate", PLANE, "--json"))["orientation"] is None


def test_json_names_what_was_not_flown(capsys):
    report = json.loads(said(capsys, "calibrate", PLANE, "--json"))
    assert report["unseen"] == ["bottom", "tail"]
    assert report["matrix_sigma"] is None
    assert report["ardupilot_adds"]
    assert max(report["offset_sigma_gauss"]) < 2e-3  # 1 mG
    assert report["heading_sigma_deg"] < 0.5  # 0.3 deg


def test_a_log_without_a_position_is_told_where_it_was(tmp_path, capsys):
    there = ("GLOBAL_POSITION_INT", "GPS_RAW_INT", "GPS2_RAW", "HOME_POSITION")
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS, left_out=there)
    assert main(["calibrate", str(log)]) == 2
    assert "no position; --place LAT,LON" in capsys.readouterr().err
    report = json.loads(said(capsys, "calibrate", log, "--place", "-35.363,149.165", "--json"))
    found = 1e3 * np.array(report["mounting"]["mag_offset_gauss"])
    assert found == pytest.approx(OFFSET_MGAUSS, abs=2.0)  # mG; 1.6 on the third axis
    assert report["dip_deg"] == pytest.approx(-66.0, abs=0.1)  # of Canberra


@pytest.mark.parametrize("place", ["here", "47.4", "90,0", "nan,8", "47,1000", "1,2,3"])
def test_a_place_that_is_none_is_one_line(place, capsys):
    assert main(["calibrate", str(PLANE), "--place", place]) == 2
    told = capsys.readouterr().err
    assert told.startswith("fuzzbee: --place")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("log", "complaint"),
    [
        ("sitl_copter_takeoff.tlog", "too few turns"),
        ("rover_no_magnetometer.tlog", "no magnetometer"),
    ],
)
def test_what_shows_nothing_is_one_line(log, complaint, capsys):
    assert main(["calibrate", str(DATA / log)]) == 2
    out, err = capsys.readouterr()
    assert not out
    told = err.splitlines()[-1]  # before it may stand that the filter is compiled
    assert complaint in told
    assert "Traceback" not in err


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's list of threads")
def test_a_fit_of_a_dozen_numbers_is_one_threads_work():
    """Threads of the linear algebra waited for each other: three times the processor's time."""
    program = "import os; from fuzzbee.cli import main; main(['calibrate', os.environ['LOG']]); "
    program += "print(len(os.listdir('/proc/self/task')))"
    clean = {key: value for key, value in os.environ.items() if "_NUM_THREADS" not in key}
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**clean, "LOG": str(PLANE)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "1"
