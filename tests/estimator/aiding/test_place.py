"""Against NOAA's published test values of WMM2025 and known places."""

from math import cos, degrees, inf, nan, radians, sin

import pytest

from estimator.aiding.place import PlaceField, field_at, resembles

MICROSECONDS_2025 = 1_735_689_600_000_000


@pytest.mark.parametrize(
    ("latitude", "longitude", "altitude_m", "expected_deg"),
    [
        # WMM2025 test values for 2025.0, NOAA/NCEI and BGS, "WMM2025_TestValues"
        (80.0, 0.0, 0.0, 1.28),
        (0.0, 120.0, 0.0, -0.16),
        (-80.0, 240.0, 0.0, 68.78),
    ],
)
def test_published_values(latitude, longitude, altitude_m, expected_deg):
    field = field_at(latitude, longitude, altitude_m, MICROSECONDS_2025)
    assert degrees(field.declination_rad) == pytest.approx(expected_deg, abs=0.02)


def test_published_dip_and_strength():
    """The first of those test values: I = 83.21 deg, F = 55178.5 nT."""
    field = field_at(80.0, 0.0, 0.0, MICROSECONDS_2025)
    assert degrees(field.dip_rad) == pytest.approx(83.21, abs=0.01)
    assert field.strength_gauss == pytest.approx(0.551785, abs=1e-6)


@pytest.mark.parametrize(
    ("share", "off_deg", "does"),
    [
        (1.0, 0.0, True),
        (0.5, 0.0, True),  # some autopilots' scale is half of reality
        (1.0, 12.0, True),
        (1.0, -20.0, False),
        (0.3, 0.0, False),
        (1.6, 0.0, False),
    ],
)
def test_a_field_as_strong_and_as_steep_resembles_the_places_own(share, off_deg, does):
    place = PlaceField(0.1, radians(60.0), 0.5)
    dip = radians(60.0 + off_deg)
    assert resembles(place, share * 0.5 * cos(dip), share * 0.5 * sin(dip)) is does


def test_it_drifts_with_the_years():
    """London passed zero declination around 2019 to 2020, coming from the west."""
    year_us = int(365.25 * 86_400e6)
    years = (2012, 2016, 2021, 2026)
    now = [field_at(51.5, 0.0, 0.0, (y - 1970) * year_us).declination_rad for y in years]
    assert now == sorted(now)
    assert now[0] < 0.0 < now[-1]


@pytest.mark.parametrize("unix_us", [0, -(10**15), 12_000_000_000_000_000_000])
def test_a_clock_that_is_far_off_still_gives_an_answer(unix_us):
    assert abs(degrees(field_at(52.0, 13.0, 50.0, unix_us).declination_rad) - 4.0) < 3.0


@pytest.mark.parametrize("place", [(90.0, 0.0, 0.0), (nan, 0.0, 0.0), (10.0, inf, 0.0)])
def test_no_answer_where_there_is_none(place):
    assert field_at(*place, MICROSECONDS_2025) is None
