"""Against NOAA's published test values of WMM2025 and known places."""

from math import cos, degrees, inf, nan, radians, sin

import pytest

from estimator.aiding.compass import differ, resembles
from estimator.geometry.earth import (
    LastPosition,
    PlaceField,
    distance_m,
    field_at,
    in_ned,
    update_position,
)

MICROSECONDS_2025 = 1_735_689_600_000_000


# WMM2025 test values for 2025.0, NOAA/NCEI and BGS, "WMM2025_TestValues": declination, deg
@pytest.mark.parametrize(
    ("latitude", "longitude", "expected_deg"),
    [(80.0, 0.0, 1.28), (0.0, 120.0, -0.16), (-80.0, 240.0, 68.78), (-80.0, -120.0, 68.78)],
)
def test_published_values(latitude, longitude, expected_deg):
    field = field_at(latitude, longitude, 0.0, MICROSECONDS_2025)
    assert degrees(field.declination_rad) == pytest.approx(expected_deg, abs=0.02)
    if latitude == 80.0:  # I = 83.21 deg, F = 55178.5 nT
        assert degrees(field.dip_rad) == pytest.approx(83.21, abs=0.01)
        assert field.strength_gauss == pytest.approx(0.551785, abs=1e-6)


def test_an_eastern_declination_and_a_dip_point_east_and_down():
    field = in_ned(PlaceField(radians(30.0), radians(60.0), 0.5))
    assert field == pytest.approx((0.25 * cos(radians(30.0)), 0.125, 0.5 * sin(radians(60.0))))


@pytest.mark.parametrize(
    ("share", "off_deg", "does"),
    [
        (1.0, 0.0, True),
        (0.5, 0.0, True),  # some autopilots' scale is half of reality
        (1.0, 12.0, True),
        (1.0, -30.0, True),  # as uncertain as that makes it
        (1.0, -40.0, False),
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
    declination_deg = degrees(field_at(52.0, 13.0, 50.0, unix_us).declination_rad)
    assert abs(declination_deg - 4.0) < 1.8  # measured 1.47


@pytest.mark.parametrize("place", [(90.0, 0.0, 0.0), (nan, 0.0, 0.0), (10.0, inf, 0.0)])
def test_no_answer_where_there_is_none(place):
    assert field_at(*place, MICROSECONDS_2025) is None


ZURICH, CANBERRA, NOWHERE = (47.4, 8.5), (-35.36, 149.17), (2e-4, -7e-5)


def after_positions(*places):
    """LastPosition after positions at sea level in 2025."""
    known = LastPosition()
    for place in places:
        known = update_position(known, *place, 0.0, MICROSECONDS_2025)
    return known


def where(known):
    return None if known.here is None else (known.here.latitude_deg, known.here.longitude_deg)


@pytest.mark.parametrize(
    ("places", "here"),
    [
        ([ZURICH], ZURICH),
        ([ZURICH, CANBERRA], ZURICH),  # one bad position moves nothing
        ([ZURICH, CANBERRA, ZURICH, CANBERRA], ZURICH),
        ([ZURICH, CANBERRA, (nan, 0.0), CANBERRA], CANBERRA),
        ([NOWHERE, CANBERRA, CANBERRA], CANBERRA),
        ([ZURICH, CANBERRA, NOWHERE], ZURICH),  # each of them was reported once
        ([ZURICH, (47.5, 8.5), (47.6, 8.5), (47.62, 8.5)], (47.62, 8.5)),  # 25 km on
        ([ZURICH, (47.5, 8.5), (47.5, 8.6)], ZURICH),
        ([(90.0, 0.0), (90.0, 0.0)], None),
    ],
)
def test_a_place_is_given_up_for_another_that_was_reported_twice(places, here):
    assert where(after_positions(*places)) == here


@pytest.mark.parametrize(
    ("one", "other", "km"),
    [
        ((0.0, 179.9), (0.0, -179.9), 22.2),  # over the date line
        ((89.9, 0.0), (89.9, 180.0), 22.2),  # over the pole
        ((47.4, 8.5), (47.4, 8.5), 0.0),
    ],
)
def test_distances(one, other, km):
    assert distance_m(one, other) == pytest.approx(1000 * km, rel=0.01)


@pytest.mark.parametrize(
    ("other", "is_unlike"),
    [((47.6, 8.9), False), ((48.4, 9.8), False), (NOWHERE, True), ((30.0, 31.0), True)],
)
def test_a_flight_of_100_km_changes_the_field_little(other, is_unlike):
    fields = [field_at(*place, 0.0, MICROSECONDS_2025) for place in (ZURICH, other)]
    assert differ(*fields) is is_unlike


def test_the_field_falls_off_with_altitude_in_metres():
    """As a dipole's, with the cube of the distance from the Earth's centre: 0.5 % in 10 km."""
    ground, high = (
        field_at(50.0, 10.0, altitude_m, MICROSECONDS_2025) for altitude_m in (0.0, 10_000.0)
    )
    expected = (6371.0 / 6381.0) ** 3
    assert high.strength_gauss / ground.strength_gauss == pytest.approx(expected, abs=3e-4)
