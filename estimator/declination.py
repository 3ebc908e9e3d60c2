"""Magnetic declination from the World Magnetic Model."""

from functools import lru_cache
from math import isfinite, radians
from typing import Any

SECONDS_A_YEAR = 365.25 * 86_400.0
UNIX_EPOCH_YEAR = 1970.0
# The years that the models at hand describe; a clock that is far off gets the nearest one.
FIRST_YEAR = 2010.0
LAST_YEAR = 2030.0
LATITUDE_LIMIT_DEG = 89.9  # at the poles the declination is undefined


def declination_rad(
    latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
) -> float | None:
    """Angle (rad, east positive) from true to magnetic north; None where it cannot be told.

    World Magnetic Model (NOAA/NCEI and BGS) of the epoch that holds the date.
    """
    numbers = (latitude_deg, longitude_deg, altitude_m)
    if not all(map(isfinite, numbers)) or abs(latitude_deg) > LATITUDE_LIMIT_DEG:
        return None
    year = UNIX_EPOCH_YEAR + unix_us * 1e-6 / SECONDS_A_YEAR
    year = min(LAST_YEAR - 0.01, max(FIRST_YEAR, year))
    model = _model(5 * int(year // 5))
    result = model.calculate(
        glat=latitude_deg,
        glon=(longitude_deg + 180.0) % 360.0 - 180.0,
        alt=1e-3 * altitude_m,
        time=year,
        allow_date_outside_lifespan=True,
    )
    return radians(float(result.d))


@lru_cache(maxsize=4)
def _model(epoch: int) -> Any:
    from pygeomag import GeoMag

    return GeoMag(base_year=epoch)
