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
from fuzzbee.replays.comparison import compare
from fuzzbee.replays.trace import Replay

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


@pytest.mark.parametrize(("path", "measured_deg"), [(FAST, 0.945), (TAKEOFF, 0.121)])
def test_fast_streams_are_nearly_as_good_as_the_autopilots_own_filter(path, measured_deg):
    """Flips and take-off at 50 Hz; the autopilot's EKF3 is 0.7 deg off over the whole flight."""
    assert rms(errors_deg(events_of(path), skip_s=5.0)[:, TOTAL]) == pytest.approx(
        measured_deg, rel=0.2
    )


def test_at_a_ground_stations_rate_velocity_makes_the_error_a_small_part():
    events = events_of(SLOW)
    aided = errors_deg(events, skip_s=40.0)
    unaided = errors_deg(without(events, Velocity), skip_s=40.0)
    assert rms(aided[:, TOTAL]) == pytest.approx(1.14, rel=0.2)
    assert rms(unaided[:, TOTAL]) == pytest.approx(6.42, rel=0.2)


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


def test_every_third_sample_lost():
    """Seeded losses of IMU messages, one in three: the errors do not grow by them (0.94 whole)."""
    events = events_of(FAST)
    rng = np.random.default_rng(7)
    kept = [e for e in events if not isinstance(e, Imu) or rng.random() > 1 / 3]
    assert rms(errors_deg(kept, 5.0)[:, TOTAL]) == pytest.approx(0.891, rel=0.2)


def test_reports_that_stop_and_come_back():
    """20 s without velocity in mid-flight: worse by a degree over the whole flight."""
    events = events_of(SLOW)
    start_us = next(e.sample.time_us for e in events if isinstance(e, Imu))
    gap_us = (start_us + 90_000_000, start_us + 110_000_000)
    heard = [
        e
        for e in events
        if not isinstance(e, Velocity) or not gap_us[0] < e.sample.time_us < gap_us[1]
    ]
    assert rms(errors_deg(heard, 40.0)[:, TOTAL]) == pytest.approx(1.17, rel=0.2)  # 1.14 whole


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
