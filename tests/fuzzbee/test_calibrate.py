"""``fuzzbee calibrate``: errors put into a log are found again, and its profile undoes them."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from drivers.simulation.simulated_vehicle import SimulatedVehicle, imu_errors
from estimator.profile import load_profile
from fuzzbee.calibration_readings import recording
from fuzzbee.calibration_report import unmixed
from fuzzbee.cli import main
from fuzzbee.replays.log_report import replay_log
from tests.fuzzbee.recording import DATA, PLANE
from tests.fuzzbee.tlogs import rewritten, table, with_iron

OFFSET_MGAUSS = (60.0, -40.0, 50.0)


def output(capsys, *arguments):
    assert main([*map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_a_profile_that_it_prints_gives_the_heading_back(tmp_path, capsys, replayed):
    """As recorded the heading is 1.66 deg off, with the iron 5.17, with the profile 1.66 (RMS)."""
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS)
    printed = output(capsys, "calibrate", log)
    found = 1e3 * np.array(tomllib.loads(printed)["calibration"]["mag_offset_gauss"])
    assert found == pytest.approx(OFFSET_MGAUSS, abs=2.0)  # mG; there are 1.3 without the iron
    assert "COMPASS_OFS_X -60." in printed
    (tmp_path / "mine.toml").write_text(printed)
    replays = [(PLANE, "imu"), (log, "imu"), (log, tmp_path / "mine.toml")]
    before, iron, after = (
        replayed(each, "--profile", profile)["error_deg"]["heading_rms"]
        for each, profile in replays
    )
    assert after < 1.2 * before < 0.5 * iron


def test_what_the_current_adds_is_found_apart(tmp_path, capsys):
    """1.5, -2 and 1 mG for each of 10 to 30 A, and as ArduPilot's COMPASS_MOT what undoes it."""
    own = (1.5, -2.0, 1.0)
    log = with_iron(PLANE, tmp_path / "current.tlog", OFFSET_MGAUSS, current_mgauss_a=own)
    report = json.loads(output(capsys, "calibrate", log, "--json"))
    found, sigma = (1e3 * np.array(report[f"current_{each}gauss_a"]) for each in ("", "sigma_"))
    assert found == pytest.approx(own, abs=0.25)  # mG/A; it is 0.17 off
    assert (np.abs(found - own) < 3.0 * sigma).all()
    assert sigma.max() < 1.0
    usual = 1e3 * np.array(report["calibration"]["mag_offset_gauss"]) - 20.0 * np.array(own)
    assert report["matrix_sigma"] is None  # anything else is by chance
    assert usual == pytest.approx(OFFSET_MGAUSS, abs=5.0)
    reported = report["ardupilot"]
    offsets = [reported[f"COMPASS_OFS_{axis}"] for axis in "XYZ"]
    assert offsets == pytest.approx([-each for each in OFFSET_MGAUSS], abs=5.0)
    assert reported["COMPASS_MOTCT"] == 2
    assert [reported[f"COMPASS_MOT_{axis}"] for axis in "XYZ"] == pytest.approx((-found).tolist())


TURNS = {
    "YAW_90": (2, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "ROLL_180": (8, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "YAW_180": (4, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("name", TURNS)
def test_a_compass_that_is_turned_is_turned_back(tmp_path, capsys, replayed, name):
    """By the plane's velocity; MAV_SENSOR_ORIENTATION has the numbers."""
    number, turn = TURNS[name]
    others = ("SCALED_IMU2", "SCALED_IMU3")
    log = with_iron(PLANE, tmp_path / "turned.tlog", OFFSET_MGAUSS, np.array(turn), left_out=others)
    report = json.loads(output(capsys, "calibrate", log, "--json"))
    assert report["orientation"] == name
    found = 1e3 * np.array(report["calibration"]["mag_offset_gauss"])
    assert found == pytest.approx(OFFSET_MGAUSS, abs=4.0)  # mG, in the axes of the readings
    assert report["ardupilot"] == {"COMPASS_ORIENT": number}
    printed = output(capsys, "calibrate", log)
    assert f"should be {name}" in printed
    (tmp_path / "mine.toml").write_text(printed)
    before, after = (
        replayed(each, "--profile", profile)["error_deg"]["heading_rms"]
        for each, profile in ((PLANE, "imu"), (log, tmp_path / "mine.toml"))
    )
    assert after < 1.2 * before


def test_another_compass_of_the_log_is_fitted(tmp_path, capsys):
    """The first carries iron, the second none; its parameters have its number."""
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS, left_out=("SCALED_IMU3",))
    first, chosen, second = (
        json.loads(output(capsys, "calibrate", log, "--json", *options))
        for options in ((), ("--compass", "0"), ("--compass", "1"))
    )
    offsets = [each["calibration"]["mag_offset_gauss"] for each in (first, chosen, second)]
    assert offsets[1] == pytest.approx(offsets[0], abs=1e-4)
    assert 1e3 * np.array(offsets[2]) == pytest.approx((0.0, 0.0, 0.0), abs=2.0)  # mG
    assert (first["message"], second["message"]) == ("RAW_IMU", "SCALED_IMU2")
    assert set(second["ardupilot"]) == {f"COMPASS_OFS2_{axis}" for axis in "XYZ"}
    assert main(["calibrate", str(log), "--compass", "2"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "no compass 2 (there is: 0, 1)" in err


@pytest.mark.parametrize("verb", ["calibrate", "tune"])
def test_a_log_of_which_much_was_refused_is_named(tmp_path, capsys, verb):
    def change(seconds, message):
        if message.get_type() == "RAW_IMU" and seconds % 5.0 < 1.0:
            message.xacc = message.yacc = message.zacc = 0
            return [message]
        return None

    log = rewritten(PLANE, tmp_path / "bad.tlog", change)
    budget = ("--sources", "2", "--cycles", "1", "--parameters", "gain", "--force")
    options = ("-o", str(tmp_path / "tuned.toml"), *budget) if verb == "tune" else ()
    assert main([verb, str(log), *options]) == 0
    (line,) = [each for each in capsys.readouterr().err.splitlines() if "refused" in each]
    assert line.startswith(f"fuzzbee: {log}: much was refused: ")


def test_json_names_what_was_not_flown_and_that_the_compass_is_in_its_place(capsys):
    report = json.loads(output(capsys, "calibrate", PLANE, "--json"))
    assert report["orientation"] is None
    assert report["unseen"] == ["bottom", "tail"]
    assert report["matrix_sigma"] is None
    assert report["ardupilot_adds"]
    assert max(report["offset_sigma_gauss"]) < 2e-3  # 1 mG
    assert report["heading_sigma_deg"] < 0.5  # 0.3 deg


def test_a_log_without_a_position_is_reported_where_it_was(tmp_path, capsys):
    there = ("GLOBAL_POSITION_INT", "GPS_RAW_INT", "GPS2_RAW", "HOME_POSITION")
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS, left_out=there)
    assert main(["calibrate", str(log)]) == 2
    assert "no position; --place LAT,LON" in capsys.readouterr().err
    report = json.loads(output(capsys, "calibrate", log, "--place", "-35.363,149.165", "--json"))
    found = 1e3 * np.array(report["calibration"]["mag_offset_gauss"])
    assert found == pytest.approx(OFFSET_MGAUSS, abs=2.0)  # mG; 1.6 on the third axis
    assert report["dip_deg"] == pytest.approx(-66.0, abs=0.1)  # of Canberra


@pytest.mark.parametrize("place", ["here", "47.4", "90,0", "nan,8", "47,1000", "1,2,3"])
def test_a_place_that_is_none_is_one_line(place, capsys):
    assert main(["calibrate", str(PLANE), "--place", place]) == 2
    reported = capsys.readouterr().err
    assert reported.startswith("fuzzbee: --place")
    assert reported.count("\n") == 1


@pytest.mark.parametrize(
    ("logs", "complaint"),
    [
        ("sitl_copter_takeoff.tlog", "too few turns"),
        ("rover_no_magnetometer.tlog", "no magnetometer"),
        ("sitl_plane_4hz.tlog sitl_plane_4hz.tlog", "20 samples a second"),
    ],
)
def test_what_shows_nothing_is_one_line(logs, complaint, capsys):
    assert main(["calibrate", *(str(DATA / log) for log in logs.split())]) == 2
    out, err = capsys.readouterr()
    assert not out
    reported = err.splitlines()[-1]  # before it may stand that the filter is compiled
    assert complaint in reported
    assert "Traceback" not in err


def bench(path, seed, motion="bench", seconds=120.0, rate_hz=50.0, errors=None):
    """A table of a simulated vehicle whose sensors have the constant errors of a seed; 0: none."""
    errors_seed = (seed if errors is None else errors) or None
    vehicle = SimulatedVehicle(seed, rate_hz, motion, bias=0.0, errors_seed=errors_seed)
    samples = [next(vehicle) for _ in range(round(seconds * rate_hz))]
    path.with_suffix(".toml").write_text(
        'axes = "frd"\ncompass_calibrated = true\ntruth = { columns = ["w", "x", "y", "z"] }'
    )
    rows = [
        (*s.gyr_rad_s, *np.divide(s.acc_m_s2, 9.80665), *s.mag_gauss, *s.q_ned_frd) for s in samples
    ]
    return table(path, rate_hz, rows, ("mx_gauss", "my_gauss", "mz_gauss", *"wxyz"))


SENSORS = ("gyr_bias_rad_s", "acc_bias_m_s2", "mag_offset_gauss")


def truth_of(seed):
    """[calibration] that undoes the errors of a seed."""
    reported = {}
    for name, (matrix, bias) in zip(SENSORS, imu_errors(seed), strict=True):
        reported |= {name: bias, f"{name[:3]}_matrix": np.linalg.inv(matrix)}
    return reported


def test_a_bench_recording_shows_the_whole_imu(tmp_path, capsys, replayed):
    """Two recordings of one IMU, and another one that is better for it."""
    logs = [bench(tmp_path / f"{k}.csv", 3) for k in (1, 2)]
    mine = tmp_path / "mine.toml"
    report = json.loads(output(capsys, "calibrate", *logs, "-o", mine, "--json"))
    truth, found = truth_of(3), report["calibration"]
    assert found["acc_bias_m_s2"] == pytest.approx(truth["acc_bias_m_s2"], abs=0.05)
    assert found["mag_offset_gauss"] == pytest.approx(truth["mag_offset_gauss"], abs=0.005)
    for name, sigma in (("gyr_matrix", 0.001), ("acc_matrix", 0.003)):
        scales = np.diag(found[name]) - np.diag(truth[name])
        assert np.abs(scales).max() < sigma, name
    assert set(report["sensors"]["sigma"]) == set(found)
    assert min(report["sensors"]["predicted"].values()) > 0.5
    assert max(report["sensors"]["field_misfits"]) < 0.02
    another = bench(tmp_path / "another.csv", 3, seconds=60.0)
    before, after = (
        replayed(another, "--profile", profile)["error_deg"]["inclination_rms"]
        for profile in ("imu", mine)
    )
    assert after < 0.5 * before
    assert load_profile(str(mine)).calibration.acc_bias_m_s2 == tuple(found["acc_bias_m_s2"])


def test_a_field_that_is_not_its_places_shows_nothing_of_the_compass(tmp_path, capsys):
    """Iron all around, as in a car: a compass turned by that would be wrong outside."""
    logs = [bench(tmp_path / f"{k}.csv", 3, seconds=60.0) for k in (1, 2)]
    report = json.loads(output(capsys, "calibrate", *logs, "--place", "30,8.55", "--json"))
    found = report["calibration"]
    assert found["mag_offset_gauss"] == [0.0, 0.0, 0.0]
    assert found["mag_matrix"] == np.eye(3).tolist()
    assert found["acc_bias_m_s2"] == pytest.approx(truth_of(3)["acc_bias_m_s2"], abs=0.05)


@pytest.mark.parametrize(
    ("seeds", "options", "complaint"),
    [
        # constants without errors, fitted to some parts of the recordings, do not predict others
        ((1, 2), {"seconds": 60.0, "errors": 0}, "no constant shows"),
        ((3,), {"seconds": 6.0, "motion": "flight"}, "shorter than"),
    ],
)
def test_what_recordings_do_not_show_is_left_alone(tmp_path, capsys, seeds, options, complaint):
    logs = [bench(tmp_path / f"{seed}.csv", seed, **options) for seed in seeds]
    assert main(["calibrate", *map(str, logs)]) == 2
    assert complaint in capsys.readouterr().err


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


@pytest.mark.parametrize(
    ("was", "others"),
    [
        (
            {"COMPASS_MOTCT": 1.0, "COMPASS_MOT_X": 30.0, "COMPASS_MOT2_X": 5.0},
            {"COMPASS_MOT_X": 0},
        ),
        ({"COMPASS_MOT3_Z": 4.0}, {"COMPASS_MOT3_Z": 0}),
        ({"COMPASS_MOTCT": 2.0, "COMPASS_MOT_X": 30.0}, {}),
    ],
)
def test_that_no_other_compass_has_its_motors_counted_by_current(
    was: dict[str, float], others: dict[str, float]
) -> None:
    found = {"COMPASS_MOTCT": 2.0, "COMPASS_MOT2_X": -7.0}
    assert unmixed(was, found) == found | others


def test_of_several_messages_with_a_velocity_one_is_read() -> None:
    trace = replay_log(PLANE, load_profile("imu"))
    steps_s = np.diff(recording(PLANE, trace, None).velocity_time_s)
    assert steps_s.min() > 0.19  # each comes five times a second
