"""``fuzzbee calibrate``: errors put into a log are found again, and its profile undoes them."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from drivers.mavlink.constants import mavlink
from estimator.profile import load_profile
from fuzzbee.calibration_report import recording, unmixed
from fuzzbee.cli import main
from fuzzbee.replays.trace import replay_log
from tests.fuzzbee.recording import PLANE, bench, rewritten, truth_of, with_iron
from tests.programs import run_python

OFFSET_MGAUSS = (60.0, -40.0, 50.0)


def offset_mgauss(report):
    return 1e3 * np.array(report["calibration"]["mag_offset_gauss"])


@pytest.fixture
def heading_rms(replayed):
    """RMS of the errors of a log with a profile, deg."""
    return lambda log, profile: replayed(log, "--profile", profile)["error_deg"]["heading_rms"]


def test_a_profile_that_it_prints_gives_the_heading_back(tmp_path, printed, heading_rms):
    log, mine = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS), tmp_path / "mine.toml"
    text = printed("calibrate", log)
    # mG; there are 1.3 without the iron
    assert offset_mgauss(tomllib.loads(text)) == pytest.approx(OFFSET_MGAUSS, abs=2.0)
    assert "COMPASS_OFS_X -60." in text
    mine.write_text(text)
    assert heading_rms(log, mine) < 1.2 * heading_rms(PLANE, "imu") < 0.5 * heading_rms(log, "imu")


def test_what_the_current_adds_is_found_apart(tmp_path, reported):
    """And as ArduPilot's COMPASS_MOT what undoes it."""
    own = (1.5, -2.0, 1.0)
    log = with_iron(PLANE, tmp_path / "current.tlog", OFFSET_MGAUSS, current_mgauss_a=own)
    report = reported("calibrate", log)
    found, sigma = (1e3 * np.array(report[f"current_{each}gauss_a"]) for each in ("", "sigma_"))
    assert found == pytest.approx(own, abs=0.25)  # mG/A; it is 0.17 off
    assert (np.abs(found - own) < 3.0 * sigma).all()
    assert sigma.max() < 1.0
    assert report["matrix_sigma"] is None  # anything else is by chance
    assert offset_mgauss(report) - 20.0 * np.array(own) == pytest.approx(OFFSET_MGAUSS, abs=5.0)
    theirs = report["ardupilot"]
    offsets, motors = ([theirs[f"COMPASS_{k}_{axis}"] for axis in "XYZ"] for k in ("OFS", "MOT"))
    assert offsets == pytest.approx([-each for each in OFFSET_MGAUSS], abs=5.0)
    assert motors == pytest.approx((-found).tolist())
    assert theirs["COMPASS_MOTCT"] == 2


TURNS = {
    "YAW_90": (2, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "ROLL_180": (8, [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "YAW_180": (4, [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("name", TURNS)
def test_a_compass_that_is_turned_is_turned_back(tmp_path, printed, reported, heading_rms, name):
    """By the plane's velocity; MAV_SENSOR_ORIENTATION has the numbers."""
    number, turn = TURNS[name]
    others, mine = ("SCALED_IMU2", "SCALED_IMU3"), tmp_path / "mine.toml"
    log = with_iron(PLANE, tmp_path / "turned.tlog", OFFSET_MGAUSS, np.array(turn), left_out=others)
    report = reported("calibrate", log)
    assert report["orientation"] == name
    # mG, in the axes of the readings
    assert offset_mgauss(report) == pytest.approx(OFFSET_MGAUSS, abs=4.0)
    assert report["ardupilot"] == {"COMPASS_ORIENT": number}
    mine.write_text(printed("calibrate", log))
    assert f"should be {name}" in mine.read_text()
    assert heading_rms(log, mine) < 1.2 * heading_rms(PLANE, "imu")


def test_a_compass_mounted_by_angles_of_its_own_gets_no_other_orientation(tmp_path, reported):
    """COMPASS_ORIENT 100 is a custom one: what its angles are is not in the number."""
    waiting = [mavlink().MAVLink_param_value_message(b"COMPASS_ORIENT", 100.0, 9, 1, 0)]
    turned = with_iron(PLANE, tmp_path / "turned.tlog", OFFSET_MGAUSS, np.array(TURNS["YAW_90"][1]))
    log = rewritten(turned, tmp_path / "a.tlog", lambda _, m: [m, *(waiting and [waiting.pop()])])
    report = reported("calibrate", log)
    assert report["orientation"] is None
    assert "COMPASS_ORIENT" not in report["ardupilot"]


def test_another_compass_of_the_log_is_fitted(tmp_path, reported, refused):
    """The first carries iron, the second none; its parameters have its number."""
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS, left_out=("SCALED_IMU3",))
    first = reported("calibrate", log)
    chosen, second = (reported("calibrate", log, "--compass", number) for number in (0, 1))
    assert offset_mgauss(chosen) == pytest.approx(offset_mgauss(first), abs=0.1)
    assert offset_mgauss(second) == pytest.approx((0.0, 0.0, 0.0), abs=2.0)
    assert (first["message"], second["message"]) == ("RAW_IMU", "SCALED_IMU2")
    assert set(second["ardupilot"]) == {f"COMPASS_OFS2_{axis}" for axis in "XYZ"}
    assert "no compass 2 (there is: 0, 1)" in refused("calibrate", log, "--compass", 2)


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


def test_json_names_what_was_not_flown_and_that_the_compass_is_in_its_place(reported):
    report = reported("calibrate", PLANE)
    assert report["readings"] > reported("calibrate", PLANE, "--from", 60)["readings"]
    assert (report["orientation"], report["unseen"]) == (None, ["bottom", "tail"])
    assert report["matrix_sigma"] is None
    assert report["ardupilot_adds"]
    assert max(report["offset_sigma_gauss"]) < 2e-3  # 1 mG
    assert report["heading_sigma_deg"] < 0.5  # 0.3 deg


def test_a_log_without_a_position_is_reported_where_it_was(tmp_path, reported, refused):
    there = ("GLOBAL_POSITION_INT", "GPS_RAW_INT", "GPS2_RAW", "HOME_POSITION")
    log = with_iron(PLANE, tmp_path / "iron.tlog", OFFSET_MGAUSS, left_out=there)
    assert "no position; --place LAT,LON" in refused("calibrate", log)
    report = reported("calibrate", log, "--place", "-35.363,149.165")
    assert offset_mgauss(report) == pytest.approx(OFFSET_MGAUSS, abs=2.0)  # 1.6 on the third axis
    assert report["dip_deg"] == pytest.approx(-66.0, abs=0.1)  # of Canberra


def test_a_bench_recording_shows_the_whole_imu(tmp_path, reported, replayed):
    """Two recordings of one IMU, and another one that is better for it."""
    logs = [bench(tmp_path / f"{k}.csv", 3) for k in (1, 2)]
    mine = tmp_path / "mine.toml"
    report = reported("calibrate", *logs, "-o", mine)
    truth, found = truth_of(3), report["calibration"]
    assert found["acc_bias_m_s2"] == pytest.approx(truth["acc_bias_m_s2"], abs=0.05)
    assert found["mag_offset_gauss"] == pytest.approx(truth["mag_offset_gauss"], abs=0.005)
    for name, sigma in (("gyr_matrix", 0.001), ("acc_matrix", 0.003)):
        scales = np.diag(found[name]) - np.diag(truth[name])
        assert np.abs(scales).max() < sigma, name
    assert set(report["sensors"]["sigma"]) == set(found)
    assert min(report["sensors"]["predicted"].values()) > 0.5
    assert max(report["sensors"]["field_misfits"]) < 0.02
    other = bench(tmp_path / "other.csv", 3, seconds=60.0)
    before, after = (
        replayed(other, "--profile", each)["error_deg"]["inclination_rms"] for each in ("imu", mine)
    )
    assert after < 0.5 * before
    assert load_profile(str(mine)).calibration.acc_bias_m_s2 == tuple(found["acc_bias_m_s2"])


def test_a_field_that_is_not_its_places_shows_nothing_of_the_compass(tmp_path, reported):
    """Iron all around, as in a car: a compass turned by that would be wrong outside."""
    logs = [bench(tmp_path / f"{k}.csv", 3, seconds=60.0) for k in (1, 2)]
    found = reported("calibrate", *logs, "--place", "30,8.55")["calibration"]
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
def test_what_recordings_do_not_show_is_left_alone(tmp_path, refused, seeds, options, complaint):
    logs = [bench(tmp_path / f"{seed}.csv", seed, **options) for seed in seeds]
    assert complaint in refused("calibrate", *logs)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's list of threads")
def test_a_fit_of_a_dozen_numbers_is_one_threads_work():
    """Threads of the linear algebra waited for each other: three times the processor's time."""
    program = "import os; from fuzzbee.cli import main; main(['calibrate', os.environ['LOG']]); "
    program += "print(len(os.listdir('/proc/self/task')))"
    clean = {key: value for key, value in os.environ.items() if "_NUM_THREADS" not in key}
    done = run_python("-c", program, timeout_s=900, inherited=clean, LOG=str(PLANE))
    assert done.stdout.splitlines()[-1] == "1"


@pytest.mark.parametrize(
    ("was", "others"),
    [
        ({"MOTCT": 1.0, "MOT_X": 30.0, "MOT2_X": 5.0}, {"MOT_X": 0}),
        ({"MOT3_Z": 4.0}, {"MOT3_Z": 0}),
        ({"MOTCT": 2.0, "MOT_X": 30.0}, {}),
    ],
)
def test_that_no_other_compass_has_its_motors_counted_by_current(was, others):
    was, found, others = (
        {f"COMPASS_{name}": value for name, value in each.items()}
        for each in (was, {"MOTCT": 2.0, "MOT2_X": -7.0}, others)
    )
    assert unmixed(was, found) == found | others


def test_of_several_messages_with_a_velocity_one_is_read():
    trace = replay_log(PLANE, load_profile("imu"))
    steps_s = np.diff(recording(trace, None).velocity_time_s)
    assert steps_s.min() > 0.19  # each comes five times a second
