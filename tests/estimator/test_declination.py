"""Against NOAA's published test values of WMM2025 and known places."""

from math import degrees, inf, nan

import pytest

from estimator.declination import declination_rad

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
    d = declination_rad(latitude, longitude, altitude_m, MICROSECONDS_2025)
    assert degrees(d) == pytest.approx(expected_deg, abs=0.02)


def test_it_drifts_with_the_years():
    """London passed zero declination around 2019 to 2020, coming from the west."""
    year_us = int(365.25 * 86_400e6)
    now = [declination_rad(51.5, 0.0, 0.0, (y - 1970) * year_us) for y in (2012, 2016, 2021, 2026)]
    assert now == sorted(now)
    assert now[0] < 0.0 < now[-1]


@pytest.mark.parametrize("unix_us", [0, -(10**15), 12_000_000_000_000_000_000])
def test_a_clock_that_is_far_off_still_gives_an_answer(unix_us):
    assert abs(degrees(declination_rad(52.0, 13.0, 50.0, unix_us)) - 4.0) < 3.0


@pytest.mark.parametrize("place", [(90.0, 0.0, 0.0), (nan, 0.0, 0.0), (10.0, inf, 0.0)])
def test_no_answer_where_there_is_none(place):
    assert declination_rad(*place, MICROSECONDS_2025) is None
