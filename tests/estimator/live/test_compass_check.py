"""A compass that is turned on its vehicle: velocity alone shows the heading, the field does not."""

from dataclasses import replace
from math import cos, degrees, radians, remainder, sin, tau

import numpy as np
import pytest

from estimator.estimator import Estimator
from estimator.geometry.frames import euler_rad
from estimator.profile import load_profile, merge_profile
from tests.flight import banked_flight, flown

PROFILE = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 0.0}})
FLIGHT = banked_flight(seconds=90.0)


def turned(sample, angle_deg):
    """The sample as a compass reads it that is mounted ``angle_deg`` about the body's down axis."""
    x, y, z = sample.mag_gauss
    c, s = cos(radians(angle_deg)), sin(radians(angle_deg))
    return sample._replace(mag_gauss=(c * x - s * y, s * x + c * y, z))


def heading_errors_deg(flight, estimator):
    attitudes = flown(estimator, flight)
    return np.array(
        [
            degrees(remainder(euler_rad(a.q_ned_frd)[2] - euler_rad(q)[2], tau))
            for a, q in zip(attitudes, flight.truth, strict=True)
        ]
    )


@pytest.mark.parametrize("angle_deg", [-90.0, 60.0, 90.0, 180.0])
def test_a_turned_compass_is_read_as_it_is_mounted_once_velocity_shows_the_heading(angle_deg):
    """With velocity and afterwards, when it alone gives the heading: then its iron shows, too."""
    samples = [turned(sample, angle_deg) for sample in FLIGHT.samples]
    reports = FLIGHT.reports[: 2 * len(FLIGHT.reports) // 3]
    estimator = Estimator(PROFILE)
    errors = heading_errors_deg(replace(FLIGHT, samples=samples, reports=reports), estimator)
    assert np.abs(errors[len(errors) // 2 :]).max() < 7.0  # measured 5.4
    assert estimator.compass_fault == "velocity contradicts the compass"
    off_deg = degrees(remainder(estimator.compass_off_rad - radians(angle_deg), tau))
    assert abs(off_deg) < 5.0
    late = estimator.attitude(samples[-1].time_us)
    assert late.heading_reference == "true"


def test_a_compass_that_velocity_confirms_goes_on_giving_the_heading():
    estimator = Estimator(PROFILE)
    errors = heading_errors_deg(FLIGHT, estimator)
    assert np.abs(errors[len(errors) // 2 :]).max() < 3.0
    assert estimator.compass_fault == ""
