"""Fields that are not the place's, and poor sensors: errors, and whether sigma covers them."""

from math import degrees, radians, sin

import numpy as np
import pytest

from estimator.geometry.quaternion import add, exp, rotate
from tests.estimator.conditioning.motion import (
    FIELD_NED,
    Sample,
    conditioned,
    fly,
    in_field,
    resting,
    tumbling,
)

DT = 0.01


def headings(motion, seconds, field_ned):
    """Each sample's error and sigma, degrees, with ``field_ned(time)``."""
    flight = enumerate(fly(motion, seconds, DT))
    found = []
    for s, out, _ in conditioned((in_field(s, field_ned(i * DT)) for i, s in flight), DT):
        north = rotate(s.q_ned_frd, out.magnetic_b)
        found.append((abs(np.arctan2(north[1], north[0])), out.sigma_heading_rad))
    return np.degrees(found).T


def unadmitted(error, sigma):
    """Share of the time with an error beyond 10 degrees and three sigmas."""
    return np.mean((error > 10.0) & (error > 3.0 * sigma))


def turned(begin_s, lasts_s, ramp_s):
    """A magnet that turns the field by 60 degrees about down: norm and dip stay the same."""

    def field_ned(t):
        share = np.clip(min(t - begin_s, begin_s + lasts_s - t) / ramp_s, 0.0, 1.0)
        return rotate(exp((0.0, 0.0, radians(60.0) * share)), FIELD_NED)

    return field_ned


def beside(seconds):
    """A magnet of half the place's field that the vehicle starts beside."""

    def field_ned(t):
        share = min(1.0, max(0.0, seconds + 1.0 - t))
        return add(FIELD_NED, (0.0, 0.23 * share, -0.1 * share))

    return field_ned


@pytest.mark.parametrize("motion", [resting, tumbling])
@pytest.mark.parametrize(("lasts_s", "ramp_s", "most_deg"), [(1.2, 0.01, 0.4), (4.5, 1.0, 7.5)])
def test_a_passing_magnet_that_leaves_norm_and_dip_turns_no_heading(
    motion, lasts_s, ramp_s, most_deg
):
    """The field turns at once and back, or within a second as by something that passes."""
    error, sigma = headings(motion, 60.0, turned(30.0, lasts_s, ramp_s))
    assert error[3000:].max() < most_deg
    assert sigma[3000:].max() > 40.0  # measured 86 and 49
    assert unadmitted(error, sigma) == 0.0


@pytest.mark.parametrize("motion", [resting, tumbling])
def test_a_magnet_that_stays_is_followed_with_a_large_sigma_and_left_at_once(motion):
    """It looks like an unsensed turn; the heading given up shows its end."""
    error, sigma = headings(motion, 75.0, turned(30.0, 20.0, 1.0))
    assert error[4500] == pytest.approx(60.0, rel=0.05)
    assert sigma[4500] == pytest.approx(29.3, rel=0.2)
    assert DT * np.flatnonzero(error[5000:] > 5.0).max() == pytest.approx(0.095, rel=0.2)
    assert unadmitted(error, sigma) == 0.0


@pytest.mark.parametrize(("seconds", "measured_s"), [(3.0, 2.81), (10.0, 7.0)])
def test_a_start_beside_a_magnet_is_made_good_once_it_has_been_left_for_long_enough(
    seconds, measured_s
):
    error, sigma = headings(tumbling, 45.0, beside(seconds))[:, round((seconds + 1.0) / DT) :]
    assert error[0] == pytest.approx(48.5, rel=0.2)
    assert DT * np.flatnonzero(error > 5.0).max() == pytest.approx(measured_s, rel=0.2)
    assert unadmitted(error, sigma) < 0.03  # measured 0.024: the first second
    assert error[-1] < 0.2


def sigmas_deg(samples):
    """Inclination's and heading's after the samples."""
    *_, (_, out, _) = conditioned(samples, DT)
    return degrees(out.sigma_inclination_rad), degrees(out.sigma_heading_rad)


@pytest.mark.parametrize(
    ("size_m_s2", "inclination_deg", "heading_deg"),
    [(9.80665, 0.298, 0.46), (9.95, 1.22, 1.52), (9.60, 1.73, 2.08)],
)
def test_a_force_of_another_size_than_gravity_shows_an_accelerometers_error(
    size_m_s2, inclination_deg, heading_deg
):
    found = sigmas_deg([Sample(acc=(0.0, 0.0, -size_m_s2))] * 3000)
    assert found == (pytest.approx(inclination_deg, rel=0.2), pytest.approx(heading_deg, rel=0.2))


@pytest.mark.parametrize(
    ("bend_deg", "scale", "heading_deg"), [(0.0, 1.0, 0.315), (6.0, 1.0, 5.03), (0.0, 1.25, 18.4)]
)
def test_a_field_that_is_not_the_places_widens_the_headings_sigma(bend_deg, scale, heading_deg):
    """It turns to and fro, or an axis has another scale: so it varies with the attitude."""

    def read(t, s):
        angle = radians(bend_deg) * sin(2.0 * np.pi * 0.03 * t)
        x, y, z = in_field(s, rotate(exp((0.0, 0.0, angle)), FIELD_NED)).mag
        return s._replace(mag=(x, scale * y, z))

    samples = (read(DT * k, s) for k, s in enumerate(fly(tumbling, 90.0, DT)))
    assert sigmas_deg(samples)[1] == pytest.approx(heading_deg, rel=0.2)
