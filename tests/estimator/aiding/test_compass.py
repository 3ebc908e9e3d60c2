"""Compasses that mislead or are not there, and reports that come late."""

import numpy as np
import pytest

from estimator.estimator import Estimator
from estimator.metrics import batch_angle_errors, rms
from estimator.profile import load_profile, merge_profile
from estimator.types import ZERO_VEC3
from tests.flight import banked_flight, flown

TRUE_NORTH = {"reference": {"declination_deg": 0.01}}
LATE_S = 40.0
TOTAL, HEADING, INCLINATION = range(3)


@pytest.fixture(scope="module")
def flight():
    return banked_flight()


def estimator(**updates):
    return Estimator(merge_profile(load_profile("imu"), {**TRUE_NORTH, **updates}))


def changed(flight, **readings):
    """The flight with each sample's fields replaced by functions of the sample."""
    samples = [s._replace(**{k: f(s) for k, f in readings.items()}) for s in flight.samples]
    return type(flight)(samples, flight.reports, flight.truth)


def late_errors_deg(flight, attitudes):
    times = np.array([s.time_us for s in flight.samples])
    estimates = np.array([a.q_ned_frd for a in attitudes])
    errors = np.degrees(batch_angle_errors(estimates, np.array(flight.truth)))
    return errors[times > LATE_S * 1e6]


def magnetised(*iron_gauss):
    return lambda sample: tuple(m + i for m, i in zip(sample.mag_gauss, iron_gauss, strict=True))


def test_without_a_magnetometer_the_heading_comes_from_velocity(flight):
    bare = changed(flight, mag_gauss=lambda _: ZERO_VEC3, has_mag=lambda _: False)
    attitudes = flown(estimator(), bare)
    assert attitudes[100].heading_reference == "none"
    assert attitudes[-1].heading_reference == "true"
    errors = late_errors_deg(flight, attitudes)
    assert rms(errors[:, HEADING]) < 3.0
    assert rms(errors[:, INCLINATION]) < 1.0


def test_an_uncalibrated_compass_is_calibrated_in_flight(flight):
    """0.3 gauss of hard iron where the horizontal field has 0.22: its heading says nothing."""
    wrong = changed(flight, mag_gauss=magnetised(0.2, -0.15, 0.17))
    told = estimator()
    told.set_field_calibrated(False)
    attitudes = flown(told, wrong)
    assert rms(late_errors_deg(flight, attitudes)[:, TOTAL]) < 4.0
    iron = told.snapshot.aided.hard_iron_gauss
    assert iron == pytest.approx((0.2, -0.15, 0.17), abs=0.04)


def test_its_heading_is_not_claimed_before(flight):
    told = estimator()
    told.set_field_calibrated(False)
    assert flown(told, flight)[50].sigma_heading_rad > 0.5


def test_being_told_in_flight_begins_anew(flight):
    told = estimator()
    flown(told, flight, after=lambda k: told.set_field_calibrated(False) if k == 1000 else None)
    assert told.snapshot.aided is not None


def test_a_field_unlike_the_places_own_is_not_taken_for_calibrated(flight):
    """Near Zurich the field is 0.48 gauss and dips 63 deg; this one dips 30."""
    wrong = changed(flight, mag_gauss=magnetised(0.3, 0.0, -0.12))
    at_home = Estimator(load_profile("imu"))
    at_home.set_position(47.4, 8.5, 400.0, 1_700_000_000_000_000)
    flown(at_home, wrong)
    aided = at_home.snapshot.aided
    assert aided is None or abs(aided.hard_iron_gauss[0] - 0.3) < 0.1


@pytest.mark.parametrize("late_s", [0.1, 0.2])
def test_how_late_a_receivers_reports_are_is_learnt(flight, late_s):
    """Each report tells the velocity of so long before, and says that it may."""
    steps = round(late_s * 10.0)  # ten reports a second
    reports = [
        (k, flight.reports[max(0, i - steps)][1]._replace(time_us=r.time_us, late_sigma_s=0.1))
        for i, (k, r) in enumerate(flight.reports)
    ]
    one = estimator()
    attitudes = flown(one, flight, reports=reports)
    assert one.snapshot.aided.report_lag_s == pytest.approx(0.1 * steps, abs=0.03)
    assert rms(late_errors_deg(flight, attitudes)[:, TOTAL]) < 1.5


def test_another_imu_has_other_biases(flight):
    """From 30 s on the samples are another IMU's; what was learnt of the first one goes."""
    k_30 = 1500
    bias = (0.02, -0.03, 0.01)
    late = {s.time_us for s in flight.samples[k_30:]}

    def gyr(sample):
        other = sample.time_us in late
        return tuple(w + b * other for w, b in zip(sample.gyr_rad_s, bias, strict=True))

    other = changed(flight, gyr_rad_s=gyr)
    told, untold = estimator(), estimator()
    errors = [
        late_errors_deg(flight, flown(one, other, after=tell))
        for one, tell in (
            (told, lambda k: told.change_imu() if k == k_30 - 1 else None),
            (untold, None),
        )
    ]
    assert rms(errors[0][:, TOTAL]) < 1.5
    assert rms(errors[0][:, TOTAL]) < rms(errors[1][:, TOTAL])
    assert told.snapshot.aided.gyr_bias_rad_s == pytest.approx(bias, abs=0.004)
