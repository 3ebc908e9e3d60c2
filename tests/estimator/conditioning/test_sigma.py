"""What the published sigmas know of sensors that are not as good as they look."""

from math import degrees, radians, sin

import numpy as np
import pytest

from estimator.conditioning.condition import condition
from estimator.conditioning.events.jump_signs import JumpSigns
from estimator.conditioning.events.lasting_signs import GravitySigns, HeadingSigns
from estimator.conditioning.events.step import EventsState, HeadingInflation
from estimator.conditioning.field.magnetic import (
    AlternativeField,
    FieldLook,
    FieldReference,
    MagneticState,
)
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.sigma import alternative
from estimator.conditioning.state import initial_state
from estimator.conditioning.vertical.lowpass import coefficients
from estimator.geometry.quaternion import exp, rotate, rotate_inverse
from estimator.types import Sample
from tests.estimator.conditioning.motion import fly, tumbling

PARAMS = ConditioningParams()
DT = 0.01
REST = (0.0, 0.0, 0.0)


def sigmas_deg(samples):
    """Inclination's and heading's after the samples (gyr, acc, mag)."""
    state = initial_state(PARAMS)
    for gyr, acc, mag in samples:
        state, out = condition(PARAMS, state, Sample(gyr, acc, mag, True, DT))
    return degrees(out.sigma_inclination_rad), degrees(out.sigma_heading_rad)


@pytest.mark.parametrize(
    ("size_m_s2", "inclination_deg", "heading_deg"),
    [(9.80665, 0.298, 0.46), (9.95, 1.22, 1.52), (9.60, 1.73, 2.08)],
)
def test_a_force_of_another_size_than_gravity_shows_an_accelerometers_error(
    size_m_s2, inclination_deg, heading_deg
):
    """At rest for half a minute, the dip 65 degrees."""
    found = sigmas_deg([(REST, (0.0, 0.0, -size_m_s2), (0.2, 0.0, 0.42))] * 3000)
    assert found == (
        pytest.approx(inclination_deg, rel=0.2),
        pytest.approx(heading_deg, rel=0.2),
    )


@pytest.mark.parametrize(("bend_deg", "heading_deg"), [(0.0, 0.315), (6.0, 5.03)])
def test_a_field_that_turns_to_and_fro_widens_the_headings_sigma(bend_deg, heading_deg):
    """By so much, at 0.03 Hz, on a tumbling vehicle: as beside steel."""

    def distorted():
        for i, s in enumerate(fly(tumbling, 90.0, DT)):
            angle = radians(bend_deg) * sin(2.0 * np.pi * 0.03 * DT * i)
            m = rotate_about_down(s, angle)
            yield s.gyr, s.acc, m

    assert sigmas_deg(distorted())[1] == pytest.approx(heading_deg, rel=0.2)


def rotate_about_down(s, angle):
    """The sample's field, turned about the vertical."""
    field = rotate(s.q_ned_frd, s.mag)
    return rotate_inverse(s.q_ned_frd, rotate(exp((0.0, 0.0, angle)), field))


@pytest.mark.parametrize(("scale", "heading_deg"), [(1.0, 0.315), (1.25, 18.4)])
def test_a_magnetometer_with_axes_of_different_scales_widens_the_headings_sigma(scale, heading_deg):
    """On a tumbling vehicle norm and dip vary with the attitude, and so does the heading."""
    samples = [
        (s.gyr, s.acc, (s.mag[0], scale * s.mag[1], s.mag[2])) for s in fly(tumbling, 60.0, DT)
    ]
    assert sigmas_deg(samples)[1] == pytest.approx(heading_deg, rel=0.2)


def state_of(*, dt_s, wait_s=0.0, seen_s=0.0, **signs):
    """Numbers that are all different; ``signs`` are the heading's."""
    vertical = initial_state(PARAMS).vertical
    p = (1e-4, 0, 0, 0, 2e-4, 0, 0, 3e-4, 0, 0.02)
    vertical = vertical._replace(
        estimate=vertical.estimate._replace(heading_rad=3.0, covariance=p),
        tilt=vertical.tilt._replace(variance=0.005),
        inflation=0.0004,
        coefficients=coefficients(PARAMS, dt_s, 1.0),
    )
    other = AlternativeField(0.3, 0.3, seen_s)
    reference = FieldReference(0.2, 0.4, confirmed_s=5.0, other=other, uneven=0.004)
    heading = HeadingSigns(**{"scatter": 0.0007, "confirmed_s": 1.0, **signs})
    gravity = GravitySigns(apart=0.0006, uneven=0.0005)
    jump = JumpSigns(slow=(0.1, 0.3, 0.4))
    events = EventsState(heading, gravity, jump, inflation=HeadingInflation(0.0023))
    return vertical, MagneticState(FieldLook(), reference, wait_s, True), events


def test_another_heading_counts_by_how_far_it_is_confirmed():
    """The heading is 3.0 rad; one of -3.1 rad is 0.18 rad from it, across the south."""

    def added(**state):
        now, plain = ((state_of(dt_s=0.01, **s)) for s in (state, {}))
        return alternative(*now) - alternative(*plain)

    away = 2.0 * np.pi - 6.1
    # 1 s of the 4 s that a heading needs; 50 s of the 100 s that it is remembered
    assert added(other_rad=-3.1, other_s=50.0) == pytest.approx(0.75 * 0.5 * away**2)
    late = added(other_rad=-3.1, other_s=50.0, confirmed_s=3.9)
    assert late == pytest.approx(0.15 * 0.5 * away**2)
    # a field that points elsewhere
    off = added(mean_north=0.2, mean_east=-0.1)
    assert off == pytest.approx(0.75 * np.arctan2(-0.1, 0.2) ** 2)
    # another field, seen for 2 s and the expected one for 5; heading 3.0 turns it about down
    turned = np.arctan2(0.3, 0.1) + 3.0 - 2.0 * np.pi
    assert added(seen_s=2.0) == pytest.approx(2.0 / 7.0 * turned**2)
