"""A recorded plane whose autopilot reports a place before it has one, whole and damaged."""

from pathlib import Path

import pytest

from estimator.profile import load_profile
from fuzzbee.replays.log_report import report_log
from tests.fuzzbee.tlogs import rewritten

DATA = Path(__file__).parent.parent / "data"
PLANE = DATA / "sitl_plane_4hz.tlog"
TAKEOFF = DATA / "sitl_copter_takeoff.tlog"
CONST_POS_MODE = 0xA7


def total_deg(folder, change, source=PLANE, skip_s=40.0):
    """Of the recording with each message as ``change(seconds, message)`` leaves it, if it does."""

    def kept(seconds, message):
        return [message] if change(seconds, message) else []

    path = rewritten(source, folder / "changed.tlog", kept)
    return report_log(path, load_profile("imu"), skip_s=skip_s).error_deg.total_rms


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
