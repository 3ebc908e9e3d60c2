"""The published sigmas cover sensors that are worse than they look."""

from math import degrees, radians, sin

import numpy as np
import pytest

from estimator.geometry.quaternion import exp, rotate, rotate_inverse
from tests.estimator.conditioning.motion import Sample, conditioned, fly, tumbling

DT = 0.01


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
    """The vehicle rests for half a minute; the dip is 65 degrees."""
    found = sigmas_deg([Sample(acc=(0.0, 0.0, -size_m_s2))] * 3000)
    assert found == (pytest.approx(inclination_deg, rel=0.2), pytest.approx(heading_deg, rel=0.2))


@pytest.mark.parametrize(("bend_deg", "heading_deg"), [(0.0, 0.315), (6.0, 5.03)])
def test_a_field_that_turns_to_and_fro_widens_the_headings_sigma(bend_deg, heading_deg):
    """It turns at 0.03 Hz on a tumbling vehicle, as beside steel."""

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
