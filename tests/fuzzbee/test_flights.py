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
