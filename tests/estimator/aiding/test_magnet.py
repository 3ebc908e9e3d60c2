"""Magnets beside an aided vehicle that flies straight, where velocity shows no heading."""

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from estimator.geometry.metrics import batch_angle_errors
from estimator.geometry.quaternion import add, exp, rotate, rotate_inverse
from estimator.profile import load_profile, merge_profile
from tests.flight import banked_flight, calibrated, flown

BEGIN_S = 35.0
TURN = exp((0.0, 0.0, radians(60.0)))


def half_a_gauss(field):
    return add(field, (0.1, 0.4, 0.28))


def turned(field):
    return rotate(TURN, field)


@pytest.mark.parametrize(
    ("disturb", "seconds", "worst_deg"),
    [(half_a_gauss, 4.0, 0.229), (half_a_gauss, 16.0, 0.248), (turned, 4.0, 0.468)],
)
def test_a_magnet_turns_no_heading(disturb, seconds, worst_deg):
    """Before, the aiding gave up and began anew with the magnet's field: up to 77 deg."""
    flight = banked_flight(seconds=65.0, rate_hz=25.0, report_hz=5.0, bank_rad=0.0)
    samples = list(flight.samples)
    for k, (sample, q) in enumerate(zip(samples, flight.truth, strict=True)):
        if BEGIN_S <= 1e-6 * sample.time_us < BEGIN_S + seconds:
            field = disturb(rotate(q, sample.mag_gauss))
            samples[k] = sample._replace(mag_gauss=rotate_inverse(q, field))
    # 0.01 deg instead of the WMM's: north is known, and the field points there
    profile = merge_profile(load_profile("imu"), {"reference": {"declination_deg": 0.01}})
    attitudes = flown(calibrated(profile), replace(flight, samples=samples))
    estimates = np.array([a.q_ned_frd for a in attitudes])
    errors = np.degrees(batch_angle_errors(estimates, np.array(flight.truth)))[:, 1]
    assert errors[25 * 35 :].max() == pytest.approx(worst_deg, rel=0.2)
