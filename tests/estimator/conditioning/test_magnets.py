"""Fields that are not the place's, and poor sensors: errors, and whether sigma covers them."""

from math import cos, degrees, radians, sin
from typing import NamedTuple

import numpy as np
import pytest

from estimator.geometry.quaternion import exp, rotate, rotate_inverse
from tests.estimator.conditioning.motion import Sample, conditioned, fly, resting, tumbling

DT = 0.01


class Headings(NamedTuple):
    """Each sample's error and sigma, degrees."""

    error: np.ndarray
    sigma: np.ndarray

    def unadmitted(self):
        """Share of the time with an error beyond 10 degrees and three sigmas."""
        return float(np.mean((self.error > 10.0) & (self.error > 3.0 * self.sigma)))


def headings(motion, seconds, disturb):
    """With the field in NED as ``disturb(field, time)`` makes it."""

    def disturbed(i, s):
        field = disturb(rotate(s.q_ned_frd, s.mag), i * DT)
        return s._replace(mag=rotate_inverse(s.q_ned_frd, field))

    error, sigma = [], []
    samples = (disturbed(i, s) for i, s in enumerate(fly(motion, seconds, DT)))
    for s, out, _ in conditioned(samples, DT):
        north = rotate(s.q_ned_frd, out.magnetic_b)
        error.append(abs(degrees(np.arctan2(north[1], north[0]))))
        sigma.append(degrees(out.sigma_heading_rad))
    return Headings(np.array(error), np.array(sigma))


def turned(begin_s, lasts_s, ramp_s):
    """A magnet that turns the field by 60 degrees about down: norm and dip stay the same."""

    def disturb(field, t):
        share = min(
            1.0, max(0.0, (t - begin_s) / ramp_s), max(0.0, (begin_s + lasts_s - t) / ramp_s)
        )
        c, s = cos(radians(60.0) * share), sin(radians(60.0) * share)
        return (c * field[0] - s * field[1], s * field[0] + c * field[1], field[2])

    return disturb


def beside(seconds):
    """A magnet of half the place's field that the vehicle starts beside."""

    def disturb(field, t):
        share = min(1.0, max(0.0, seconds + 1.0 - t))
        return (field[0], field[1] + 0.23 * share, field[2] - 0.1 * share)

    return disturb


@pytest.mark.parametrize("motion", [resting, tumbling])
@pytest.mark.parametrize(("lasts_s", "ramp_s", "most_deg"), [(1.2, 0.01, 0.4), (4.5, 1.0, 7.5)])
def test_a_passing_magnet_that_leaves_norm_and_dip_turns_no_heading(
    motion, lasts_s, ramp_s, most_deg
):
    """The field turns at once and back, or within a second as by something that passes."""
    seen = headings(motion, 60.0, turned(30.0, lasts_s, ramp_s))
    assert seen.error[3000:].max() < most_deg
    assert seen.sigma[3000:].max() > 40.0  # measured 86 and 49
    assert seen.unadmitted() == 0.0


@pytest.mark.parametrize("motion", [resting, tumbling])
def test_a_magnet_that_stays_is_followed_with_a_large_sigma_and_left_at_once(motion):
    """It looks like an unsensed turn; the heading given up shows its end."""
    seen = headings(motion, 75.0, turned(30.0, 20.0, 1.0))
    assert seen.error[4500] == pytest.approx(60.0, rel=0.05)
    assert seen.sigma[4500] == pytest.approx(29.3, rel=0.2)
    back_s = DT * int(np.flatnonzero(seen.error[5000:] > 5.0).max())
    assert back_s == pytest.approx(0.095, rel=0.2)
    assert seen.unadmitted() == 0.0


@pytest.mark.parametrize(("seconds", "measured_s"), [(3.0, 2.81), (10.0, 7.0)])
def test_a_start_beside_a_magnet_is_made_good_once_it_has_been_left_for_long_enough(
    seconds, measured_s
):
    seen = headings(tumbling, 45.0, beside(seconds))
    first = round((seconds + 1.0) / DT)
    assert seen.error[first] == pytest.approx(48.5, rel=0.2)
    wrong_s = DT * int(np.flatnonzero(seen.error[first:] > 5.0).max())
    assert wrong_s == pytest.approx(measured_s, rel=0.2)
    left = Headings(seen.error[first:], seen.sigma[first:])
    assert left.unadmitted() < 0.03  # measured 0.024: the first second
    assert seen.error[-1] < 0.2


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


@pytest.mark.parametrize(("bend_deg", "heading_deg"), [(0.0, 0.315), (6.0, 5.03)])
def test_a_field_that_turns_to_and_fro_widens_the_headings_sigma(bend_deg, heading_deg):

    def distorted():
        for i, s in enumerate(fly(tumbling, 90.0, DT)):
            angle = radians(bend_deg) * sin(2.0 * np.pi * 0.03 * DT * i)
            field = rotate(exp((0.0, 0.0, angle)), rotate(s.q_ned_frd, s.mag))
            yield s._replace(mag=rotate_inverse(s.q_ned_frd, field))

    assert sigmas_deg(distorted())[1] == pytest.approx(heading_deg, rel=0.2)


@pytest.mark.parametrize(("scale", "heading_deg"), [(1.0, 0.315), (1.25, 18.4)])
def test_a_magnetometer_with_axes_of_different_scales_widens_the_headings_sigma(scale, heading_deg):
    """On a tumbling vehicle norm and dip vary with the attitude, and so does the heading."""
    samples = (
        s._replace(mag=(s.mag[0], scale * s.mag[1], s.mag[2])) for s in fly(tumbling, 60.0, DT)
    )
    assert sigmas_deg(samples)[1] == pytest.approx(heading_deg, rel=0.2)
