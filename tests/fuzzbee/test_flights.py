"""Recorded flights, whole and damaged, through the pipeline that runs live."""

from math import radians
from pathlib import Path

import numpy as np
import pytest

from drivers.events import Imu, Parameter, Position, ReferenceAttitude, Velocity
from drivers.logs.open import open_log
from estimator.geometry.metrics import rms
from estimator.geometry.quaternion import log, multiply
from estimator.profile import load_profile
from fuzzbee import replay
from fuzzbee.attitudes import NORTHS
from fuzzbee.replays.score import compare
from fuzzbee.replays.trace import Replay
from tests.fuzzbee.tlogs import rewritten

DATA = Path(__file__).parent.parent / "data"
FAST = DATA / "sitl_copter_flips.tlog"
SLOW = DATA / "sitl_copter_4hz.tlog"
TAKEOFF = DATA / "sitl_copter_takeoff.tlog"
TOTAL, HEADING, INCLINATION = range(3)


def events_of(path):
    with open_log(path) as recording:
        return list(recording)


def replayed(events):
    """The trace of the only vehicle, compared with the truth."""
    run = Replay(load_profile("imu"))
    run.run(events)
    (trace,) = (t for t in run.traces.values() if len(t))
    compare(Path("events"), trace, None)
    return trace


def errors_deg(events, skip_s=0.0):
    trace = replayed(events)
    errors = np.degrees(trace["error_rad"])
    return errors[np.isfinite(errors[:, 0]) & (trace.time_s >= skip_s)]


def without(events, *kinds):
    return [event for event in events if not isinstance(event, kinds)]


def a_third_lost(events):
    """Of the IMU messages, by a seeded generator."""
    rng = np.random.default_rng(7)
    return [e for e in events if not isinstance(e, Imu) or rng.random() > 1 / 3]


def without_velocity_for_20_s(events):
    start_us = next(e.sample.time_us for e in events if isinstance(e, Imu))
    begin_us, end_us = start_us + 90_000_000, start_us + 110_000_000
    return [
        e for e in events if not isinstance(e, Velocity) or not begin_us < e.sample.time_us < end_us
    ]


@pytest.mark.parametrize(
    ("path", "change", "skip_s", "measured_deg"),
    [
        # flips and take-off at 50 Hz; the autopilot's EKF3 is 0.7 deg off over the whole flight
        (FAST, list, 5.0, 0.945),
        (TAKEOFF, list, 5.0, 0.121),
        (FAST, a_third_lost, 5.0, 0.891),
        # at a ground station's rate velocity makes the error a small part
        (SLOW, list, 40.0, 1.14),
        (SLOW, lambda events: without(events, Velocity), 40.0, 6.42),
        (SLOW, without_velocity_for_20_s, 40.0, 1.17),
    ],
)
def test_a_flight_is_estimated_as_well_as_was_measured(path, change, skip_s, measured_deg):
    errors = errors_deg(change(events_of(path)), skip_s)
    assert rms(errors[:, TOTAL]) == pytest.approx(measured_deg, rel=0.2)


def test_sigma_is_honest_at_a_ground_stations_rate():
    covered = replay(SLOW).report.coverage
    assert covered.inclination == pytest.approx(0.905, abs=0.03)
    assert covered.heading == pytest.approx(0.955, abs=0.03)


def test_sigma_is_larger_where_errors_are_larger():
    flight = replay(SLOW)
    error = flight.error_rad[:, INCLINATION]
    known = np.isfinite(error)
    sigma, error = flight.attitudes.sigma_inclination_rad[known], error[known]
    order = np.argsort(sigma, kind="stable")
    third = len(order) // 3
    assert np.degrees(rms(error[order[:third]])) == pytest.approx(0.125, rel=0.2)
    assert np.degrees(rms(error[order[-third:]])) == pytest.approx(1.27, rel=0.2)


def test_without_a_position_velocity_levels_but_the_heading_stays_magnetic():
    """Velocity then shows the attitude by itself; what is called north is the field's."""
    trace = replayed(without(events_of(FAST), Position))
    errors = np.degrees(trace["error_rad"][-500:])
    assert rms(errors[:, INCLINATION]) == pytest.approx(0.217, rel=0.2)
    assert NORTHS[trace["heading_reference"][-1]] == "magnetic"
    declination_deg = 12.7  # of the place, near Canberra
    assert rms(errors[:, HEADING]) == pytest.approx(declination_deg, abs=0.57)  # 13.17


def test_the_autopilots_trim_is_taken_off_before_the_comparison():
    """AHRS_TRIM 0.1 rad in roll: its attitude is of the vehicle, the estimate of the IMU."""
    events = without(events_of(DATA / "sub_bluerov.tlog"), Parameter)
    vehicle = next(e.vehicle for e in events if isinstance(e, Imu))
    trim = 0.1
    trimmed = [Parameter(vehicle, 0, "AHRS_TRIM_X", trim), *events]
    plain, shifted = (replayed(each)["reference_q_ned_frd"] for each in (events, trimmed))
    k = int(np.flatnonzero(np.isfinite(plain[:, 0]))[0])
    before, after = (tuple(q[k].tolist()) for q in (plain, shifted))
    conjugate = (before[0], -before[1], -before[2], -before[3])
    assert log(multiply(conjugate, after)) == pytest.approx((trim, 0.0, 0.0), abs=radians(1e-6))
    assert any(isinstance(e, ReferenceAttitude) for e in events)


# A plane whose autopilot reports a place before it has one
PLANE = DATA / "sitl_plane_4hz.tlog"
CONST_POS_MODE = 0xA7


def total_deg(folder, change, source=PLANE, skip_s=40.0):
    """Of the recording with each message as ``change(seconds, message)`` leaves it, if it does."""

    def kept(seconds, message):
        return [message] if change(seconds, message) else []

    path = rewritten(source, folder / "changed.tlog", kept)
    return replay(path, skip_s=skip_s).report.error_deg.total_rms


def late(seconds, message):
    """For 70 s near (0, 0) and standing by its own word, in flight already."""
    kind = message.get_type()
    if seconds >= 70.0:
        return True
    if kind == "GPS_RAW_INT":
        message.fix_type, message.lat, message.lon = 1, 0, 0
    elif kind == "GLOBAL_POSITION_INT":
        message.lat, message.lon = 2081 + int(10 * seconds), -732
    elif kind == "EKF_STATUS_REPORT":
        message.flags = CONST_POS_MODE
    return kind != "LOCAL_POSITION_NED"


def lost(begin_s, end_s, wrong_m_s):
    """Without satellites: LOCAL_POSITION_NED ends, GLOBAL_POSITION_INT goes on and astray."""

    def change(seconds, message):
        kind = message.get_type()
        if not begin_s <= seconds < end_s:
            return True
        if kind == "GPS_RAW_INT":
            message.fix_type = 1
        elif kind == "EKF_STATUS_REPORT":
            message.flags = CONST_POS_MODE
        elif kind == "GLOBAL_POSITION_INT":
            astray = min(1.0, (seconds - begin_s) / 4.0)
            message.vx += round(100 * wrong_m_s * astray)
            message.vy -= round(100 * wrong_m_s * astray**2)
        return kind != "LOCAL_POSITION_NED"

    return change


def lacking(*kinds):
    return lambda _, message: message.get_type() not in kinds


@pytest.mark.parametrize(
    ("change", "source", "skip_s", "measured_deg"),
    [
        # from 30 s after the fix on; 10.6 with the field of the Gulf of Guinea
        (late, PLANE, 100.0, 1.09),
        (lacking("GPS_RAW_INT"), PLANE, 40.0, 1.0),
        (lacking("EKF_STATUS_REPORT"), PLANE, 40.0, 1.0),
        (lacking("GPS_RAW_INT", "EKF_STATUS_REPORT"), PLANE, 40.0, 1.0),
        # 4 m/s wrong for 10 s; 0.52 without any velocity, 0.12 with velocity all the time
        (lost(15.0, 25.0, 4.0), TAKEOFF, 5.0, 0.287),
    ],
)
def test_what_is_reported_without_a_fix_is_left_out(tmp_path, change, source, skip_s, measured_deg):
    assert total_deg(tmp_path, change, source, skip_s) == pytest.approx(measured_deg, rel=0.2)


def test_velocity_without_a_fix_is_left_out_to_the_last_digit(tmp_path):
    a_little, much = (total_deg(tmp_path, lost(80.0, 110.0, m_s)) for m_s in (0.0, 8.0))
    assert a_little == much
