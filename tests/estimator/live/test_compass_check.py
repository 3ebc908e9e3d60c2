"""A compass that is turned on its vehicle: velocity alone shows the heading, the field does not."""

from dataclasses import replace
from math import cos, degrees, radians, remainder, sin, tau

import pytest

from estimator.estimator import Estimator
from estimator.profile import load_profile, merge_profile
from tests.flight import HEADING, banked_flight, changed, errors_deg, flown

PROFILE = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 0.0}})
FLIGHT = banked_flight(seconds=90.0)


def turned(sample, angle_deg):
    """The sample as a compass reads it that is mounted ``angle_deg`` about the body's down axis."""
    x, y, z = sample.mag_gauss
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    return sample._replace(mag_gauss=(c * x - s * y, s * x + c * y, z))


def heading_errors_deg(flight, estimator):
    return errors_deg(flight, flown(estimator, flight))[:, HEADING]


@pytest.mark.parametrize("angle_deg", [-90.0, 60.0, 90.0, 180.0])
def test_a_turned_compass_is_read_as_it_is_mounted_once_velocity_shows_the_heading(angle_deg):
    """With velocity and afterwards, when it alone gives the heading: then its iron shows, too."""
    flight = changed(FLIGHT, lambda sample, _: turned(sample, angle_deg))
    flight = replace(flight, reports=FLIGHT.reports[: 2 * len(FLIGHT.reports) // 3])
    estimator = Estimator(PROFILE)
    errors = heading_errors_deg(flight, estimator)
    assert errors[len(errors) // 2 :].max() < 7.0  # measured 5.4
    assert estimator.compass_fault == "velocity contradicts the compass"
    off_deg = degrees(remainder(estimator.compass_off_rad - radians(angle_deg), tau))
    assert abs(off_deg) < 5.0
    late = estimator.attitude(flight.samples[-1].time_us)
    assert late.heading_reference == "true"


def test_a_compass_that_velocity_confirms_goes_on_giving_the_heading():
    estimator = Estimator(PROFILE)
    errors = heading_errors_deg(FLIGHT, estimator)
    assert errors[len(errors) // 2 :].max() < 3.0
    assert estimator.compass_fault == ""
