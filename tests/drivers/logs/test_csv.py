"""Tables of other people: the same readings, however they are written, give the same samples."""

import os
from math import pi

import numpy as np
import pytest

from drivers.events import Imu, Notice, Position, ReferenceAttitude, Velocity
from drivers.logs.open import open_log
from estimator.errors import InputError
from tests.drivers.logs.tables import (
    DATES,
    FIELD,
    FLU,
    NAMELESS,
    NAMES,
    ROWS,
    WAYS,
    nameless,
    readings,
    table,
    toml,
)
from tests.drivers.logs.writers import malformed, of
from tests.vocabulary import assert_attitude_close


def written(path, text, encoding="utf-8", about=None):
    path.write_bytes(text.encode(encoding))
    if about is not None:
        path.with_suffix(".toml").write_text(about, encoding="utf-8")
    return path


def imu_rows(path):
    return [event.sample for event in of(Imu, open_log(path))]


@pytest.mark.parametrize(("text", "encoding", "about"), WAYS.values(), ids=WAYS)
def test_the_same_readings_in_all_ways(tmp_path, text, encoding, about):
    samples = imu_rows(written(tmp_path / "imu.csv", text(), encoding, about))
    t, gyr, acc, mag = readings()
    assert len(samples) == ROWS
    times_us = np.array([s.time_us for s in samples])
    assert np.array_equal(times_us - times_us[0], np.round(1e6 * t))
    # fifteen digits of a decimal number
    assert np.allclose([s.gyr_rad_s for s in samples], gyr, rtol=0, atol=1e-12)
    assert np.allclose([s.acc_m_s2 for s in samples], acc, rtol=0, atol=1e-12)
    assert np.allclose([s.mag_gauss for s in samples], mag, rtol=0, atol=1e-12)


def test_truth_and_velocity_along_other_axes(tmp_path, printed):
    """ENU and angles in degrees become NED; the east of a velocity comes first."""
    columns = (*readings()[:3], np.ones((ROWS, 1)) * [10.0, 0.0, 90.0, 2.0, 1.0, -3.0])
    about = toml(
        truth={"columns": ["r", "p", "y"], "unit": "deg", "axes": "flu"},
        velocity={"columns": ["vx", "vy", "vz"], "axes": "enu"},
    )
    path = written(tmp_path / "a.csv", table([f"{NAMES},r,p,y,vx,vy,vz"], columns), about=about)
    events = list(open_log(path))
    truth, *others = of(ReferenceAttitude, events)
    assert (truth.source, len(others)) == ("sim", ROWS - 1)
    # forward is north where it was 90 deg left of east; the right side is down by 10 deg
    turned = (np.cos(pi / 36), np.sin(pi / 36), 0.0, 0.0)
    assert_attitude_close(truth.q_ned_frd, turned, 1e-9)
    assert of(Velocity, events)[0].sample.velocity_ned_m_s == (1.0, 2.0, 3.0)
    (line,) = [x for x in printed("replay", path).splitlines() if x.startswith("reference")]
    assert line.split() == ["reference", "truth"]


PLACES = {  # names that leave nothing open need no description; a place may lack its altitude
    "lat_deg,lon_deg,alt_m,vel_n_m_s,vel_e_m_s,vel_d_m_s": ("", 6),
    "Latitude (deg),Longitude (°),Altitude [m],V North [m/s],V East [m/s],V Down [m/s]": ("", 6),
    "la,lo": (toml(position={"columns": ["la", "lo"]}), 2),
}


@pytest.mark.parametrize("names", PLACES)
def test_place_and_velocity(tmp_path, names):
    about, count = PLACES[names]
    fix = np.ones((ROWS, 1)) * [47.5, 8.5, 488.0, 1.0, 2.0, 3.0][:count]
    text = table([f"{NAMES},{names}"], (*readings()[:3], fix))
    events = list(open_log(written(tmp_path / "a.csv", text, about=about)))
    velocities = {event.sample.velocity_ned_m_s for event in of(Velocity, events)}
    assert velocities == ({(1.0, 2.0, 3.0)} if count == 6 else set())
    place = of(Position, events)[0]
    altitude_m = 488.0 if count == 6 else 0.0
    assert (place.latitude_deg, place.longitude_deg, place.altitude_m) == (47.5, 8.5, altitude_m)


def test_what_is_empty_is_not_there_and_what_is_no_number_is_counted(tmp_path):
    """A field every tenth row, dates in words, a note among the rows, a row cut short."""
    _, gyr, acc, mag = readings()
    mag[np.arange(ROWS) % 10 != 0] = np.nan
    heading = NAMES.replace("time_s", "timestamp iso8601") + FIELD
    lines = table([heading], (DATES, gyr, acc, mag)).splitlines()
    lines[6] = "pause here"
    lines[8] = lines[8][:60]
    lines[10] = lines[10].replace(",", ",#", 1)
    path = written(tmp_path / "a.csv", "\n".join(lines))
    events = list(open_log(path))
    imus = of(Imu, events)
    assert (len(imus), malformed(events)) == (ROWS - 3, 3)
    assert sum(event.sample.has_mag for event in imus) == ROWS // 10


@pytest.mark.parametrize("begin_s", [9.3e12, 1e15, -1e19])
def test_times_that_do_not_fit_64_bits_are_none(tmp_path, refused, begin_s):
    t, *others = readings()
    path = written(tmp_path / "a.csv", table([NAMES + FIELD], (begin_s + 1e6 * t, *others)))
    words = f"no IMU data that can be used: {ROWS} x malformed"
    assert refused("replay", path) == f"fuzzbee: {path}: {words}"


# No number; no accelerometer; half a gyroscope.
BAD_ROWS = ("0.5,0.1,ERR,0.1,0,0,9.8,0.2,0,0.4", "0.5,0.1,0.1,0.1,,,,,,", "0.5,0.1,,0.1,0,0,9.8,,,")


def test_a_field_that_is_no_number_costs_no_sample_and_is_reported(tmp_path, replayed):
    lines = table([NAMES + FIELD], readings()).splitlines()
    lines[4:20] = [f"{line.rpartition(',')[0]},ERR" for line in lines[4:20]]
    path = written(tmp_path / "a.csv", "\n".join([*lines, *BAD_ROWS]))
    report = replayed(path)
    assert report["imu"]["samples"] == ROWS
    assert report["rejected"] == {"malformed": 17, "not_finite": 2}


@pytest.mark.parametrize("blank", ["?", "--", "#N/A", "NaN", "null"])
def test_a_field_that_is_not_there_costs_no_sample(tmp_path, blank):
    t, gyr, acc, _ = readings()
    lines = table([NAMES], (t, gyr, acc)).splitlines()
    rows = [f"{line},{blank},{blank},{blank}" for line in lines[1:]]
    path = written(tmp_path / "a.csv", "\n".join([lines[0] + FIELD, *rows]))
    assert [sample.has_mag for sample in imu_rows(path)] == [False] * ROWS


@pytest.mark.parametrize(
    ("names", "about", "words"),
    [
        (NAMES.replace("gyr_x", "rate_x"), None, "gyroscope x is missing"),
        (NAMES.replace("time_s", "stamp"), None, "is known as the time; there are: stamp"),
        (NAMES.replace("time_s", "time"), None, "unit of time, column 'time', is not given"),
        (NAMES.replace("gyr_y_rad_s", "gyr_y"), None, "unit of gyroscope, column 'gyr_y'"),
        (NAMES.replace("acc_z_m_s2", "gyr_x_deg_s"), None, "may be 'gyr_x_rad_s', 'gyr_x_deg_s'"),
        (NAMES, 'gyroscope = { columns = ["a", "b", "c"] }', "no column is called 'a'"),
        (NAMES, 'gyroscope = { columns = ["a", "b"] }', "gyroscope: needs 3 columns, not 2"),
        *(
            (NAMES, f"gyroscope = {{ columns = [1, 2, {n}] }}", f"no column {n}, only 1 to 7")
            for n in (-1, 0, 8)
        ),
        (NAMES, 'gyroscope = { unit = "rpm" }', "gyroscope: no unit of it is known as 'rpm'"),
        (NAMES, "accelerometer = { scale = 0.0 }", "Expected float > 0.0 - at accelerometer.scale"),
        (NAMES, "time = { scale = nan }", "Expected float"),
        (NAMES, 'axes = "xyz"', "axes 'xyz': must be frd, flu, rfu or such as"),
        (NAMES, 'axes = ["x", "x", "z"]', "must be frd"),
        (NAMES, "gyro = {}", "unknown field gyro"),
        (NAMES, "gyroscope = [", "no TOML file"),
        (NAMES, "gyroscope = 1" + "0" * 5000, "no TOML file"),
        (NAMES, "truth = { columns = [2, 3, 4] }", "unit of truth"),
        (NAMES, 'truth = { columns = [2, 3, 4, 5], axes = "rfu" }', "of an attitude: must be frd"),
    ],
)  # fmt: skip
def test_what_is_not_clear_is_one_line(tmp_path, refused, names, about, words):
    path = written(tmp_path / "a.csv", table([names], readings()[:3]), about=about)
    assert words in refused("replay", path)


def test_what_is_no_table_and_a_pipe_that_should_describe_one(tmp_path):
    with pytest.raises(InputError, match="no table"):
        open_log(written(tmp_path / "b.csv", "once,upon,a,time\n" * 20))
    path = written(tmp_path / "a.csv", table([NAMES], readings()[:3]))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: not a file"):
        list(open_log(path, tmp_path / "pipe"))


@pytest.mark.parametrize("output", ["03/01/2024 12:00:00", "12:00:00.25"])
def test_a_time_that_nobody_can_be_sure_of_is_shown(tmp_path, output):
    lines = table([NAMES], readings()[:3]).replace("\n0,", f"\n{output},")
    path = written(tmp_path / "a.csv", lines)
    with pytest.raises(InputError, match=f"the time '{output}' in column 'time_s' is no number"):
        open_log(path)


def test_axes_that_nobody_described_are_questioned_once(tmp_path):
    """An accelerometer whose z is up, at two rows a second, once without a word and once with."""
    _, gyr, acc, _ = readings()  # who looks five times a second at most sees each
    text = table([NAMES], (0.5 * np.arange(ROWS), gyr, acc * FLU))
    for about, count in ((None, 1), ('axes = "frd"', 0)):
        path = written(tmp_path / "a.csv", text, about=about)
        notices = [event.text for event in of(Notice, open_log(path))]
        assert sum("accelerometer z is positive" in each for each in notices) == count
        assert bool(notices) == count


def test_replay_of_a_table_described_elsewhere(tmp_path, replayed, refused):
    path = written(tmp_path / "a.csv", nameless())
    (tmp_path / "columns.toml").write_text(NAMELESS)
    report = replayed(path, "--columns", tmp_path / "columns.toml")
    assert report["imu"]["messages"] == {"CSV": ROWS}
    line = refused("replay", path, "--columns", tmp_path / "none.toml")
    assert "none.toml: no such file" in line
