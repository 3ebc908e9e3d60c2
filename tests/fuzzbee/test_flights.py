"""Recorded flights, whole and damaged, through the pipeline that runs live."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from estimator.geometry.metrics import rms
from estimator.geometry.quaternion import conjugate, log, multiply
from fuzzbee import replay
from tests.fuzzbee.recording import DATA, FLIPS, PLANE, SLOW, TAKEOFF, rewritten

HEADING, INCLINATION = 1, 2
CONST_POS_MODE = 0xA7
UNKNOWN = 65535  # of a speed or a course


def changed(folder, change, source, skip_s=0.0):
    """The replay of a recording with each message as ``change(seconds, message)`` leaves it."""

    def kept(seconds, message):
        return [message] if change(seconds, message) else []

    return replay(rewritten(source, folder / "changed.tlog", kept), skip_s=skip_s)


def lacking(*kinds):
    return lambda _, message: message.get_type() not in kinds


def a_third_lost():
    """Of the IMU messages, by a seeded generator."""
    rng = np.random.default_rng(7)
    return lambda _, message: message.get_type() != "RAW_IMU" or rng.random() > 1 / 3


def without_velocity(begin_s, end_s):
    def change(seconds, message):
        if not begin_s < seconds < end_s:
            return True
        if message.get_type() == "GPS_RAW_INT":
            message.vel = message.cog = UNKNOWN
        return message.get_type() not in ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED")

    return change


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


@pytest.mark.parametrize(
    ("source", "change", "skip_s", "measured_deg"),
    [
        # flips and take-off at 50 Hz; the autopilot's EKF3 is 0.7 deg off over the whole flight
        (FLIPS, lacking(), 5.0, 0.945),
        (TAKEOFF, lacking(), 5.0, 0.121),
        (FLIPS, a_third_lost(), 5.0, 0.519),
        # at a ground station's rate velocity makes the error a small part
        (SLOW, lacking(), 40.0, 1.14),
        (SLOW, without_velocity(0.0, np.inf), 40.0, 6.43),
        (SLOW, without_velocity(90.0, 110.0), 40.0, 1.17),
        # from 30 s after the fix on; 10.6 with the field of the Gulf of Guinea
        (PLANE, late, 100.0, 1.09),
        (PLANE, lacking("GPS_RAW_INT"), 40.0, 1.0),
        (PLANE, lacking("EKF_STATUS_REPORT"), 40.0, 1.0),
        (PLANE, lacking("GPS_RAW_INT", "EKF_STATUS_REPORT"), 40.0, 1.0),
        # 4 m/s wrong for 10 s; 0.52 without any velocity, 0.12 with velocity all the time
        (TAKEOFF, lost(15.0, 25.0, 4.0), 5.0, 0.287),
    ],
)
def test_a_flight_is_estimated_as_was_measured(tmp_path, source, change, skip_s, measured_deg):
    """What is reported without a fix is left out."""
    report = changed(tmp_path, change, source, skip_s).report
    assert report.error_deg.total_rms == pytest.approx(measured_deg, rel=0.2)


def test_velocity_without_a_fix_is_left_out_to_the_last_digit(tmp_path):
    right, wrong = (changed(tmp_path, lost(80, 110, m_s), PLANE, 40.0).report for m_s in (0.0, 8.0))
    assert right.error_deg == wrong.error_deg


def test_sigma_is_honest_at_a_ground_stations_rate_and_larger_where_errors_are_larger():
    flight = replay(SLOW)
    covered = flight.report.coverage
    assert (covered.inclination, covered.heading) == pytest.approx((0.905, 0.955), abs=0.03)
    error = flight.error_rad[:, INCLINATION]
    known = np.isfinite(error)
    sigma, error = flight.attitudes.sigma_inclination_rad[known], error[known]
    order = np.argsort(sigma, kind="stable")
    third = len(order) // 3
    ends_deg = [np.degrees(rms(error[each])) for each in (order[:third], order[-third:])]
    assert ends_deg == pytest.approx([0.125, 1.27], rel=0.2)


def test_without_a_position_velocity_levels_but_the_heading_stays_magnetic(tmp_path):
    """Velocity then shows the attitude by itself; what is called north is the field's."""
    flight = changed(tmp_path, lacking("GLOBAL_POSITION_INT", "GPS_RAW_INT"), FLIPS)
    errors = np.degrees(flight.error_rad[-500:])
    assert rms(errors[:, INCLINATION]) == pytest.approx(0.217, rel=0.2)
    assert flight.attitudes.heading_reference[-1] == "magnetic"
    declination_deg = 12.7  # of the place, near Canberra
    assert rms(errors[:, HEADING]) == pytest.approx(declination_deg, abs=0.57)  # 13.17


def test_the_autopilots_trim_is_taken_off_before_the_comparison(tmp_path):
    """AHRS_TRIM 0.1 rad in roll: its attitude is of the vehicle, the estimate of the IMU."""

    def trimmed(trim_rad):
        waiting = [dialect.MAVLink_param_value_message(b"AHRS_TRIM_X", trim_rad, 9, 1, 0)]

        def change(_, message):
            is_parameter = message.get_type() == "PARAM_VALUE"
            return [*([] if is_parameter else [message]), *(waiting and [waiting.pop()])]

        made = rewritten(DATA / "sub_bluerov.tlog", tmp_path / "trimmed.tlog", change)
        reference = replay(made).reference_q_ned_frd
        known = reference[np.isfinite(reference[:, 0])]
        return tuple(known[len(known) // 2].tolist())

    turned = log(multiply(conjugate(trimmed(0.0)), trimmed(0.1)))
    assert turned == pytest.approx((0.1, 0.0, 0.0), abs=np.radians(1e-6))
