"""The magnetic field of a place, from the World Magnetic Model."""

from functools import lru_cache
from math import atan2, hypot, isfinite, radians
from typing import Any, NamedTuple

SECONDS_A_YEAR = 365.25 * 86_400.0
UNIX_EPOCH_YEAR = 1970.0
# The years that the models at hand describe; a clock that is far off gets the nearest one.
FIRST_YEAR = 2010.0
LAST_YEAR = 2030.0
# A compass whose field is off by more than this is not calibrated; some autopilots'
# scale is half of reality.
LEAST_STRENGTH, MOST_STRENGTH = 0.4, 1.4
MOST_DIP_OFF_RAD = radians(15.0)
LATITUDE_LIMIT_DEG = 89.9  # at the poles the declination is undefined
NANOTESLA_PER_GAUSS = 1e5


class PlaceField(NamedTuple):
    """Declination (east positive) and dip (down positive) in rad, and the field's strength."""

    declination_rad: float
    dip_rad: float
    strength_gauss: float


def field_at(
    latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
) -> PlaceField | None:
    """The field at a place and a date; None where it cannot be told.

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
    return PlaceField(
        radians(float(result.d)),
        radians(float(result.i)),
        float(result.f) / NANOTESLA_PER_GAUSS,
    )


def resembles(place: PlaceField, horizontal_gauss: float, down_gauss: float) -> bool:
    """Whether a field seen there may be the place's own, as strong and as steep."""
    share = hypot(horizontal_gauss, down_gauss) / place.strength_gauss
    off = atan2(down_gauss, horizontal_gauss) - place.dip_rad
    return LEAST_STRENGTH <= share <= MOST_STRENGTH and abs(off) <= MOST_DIP_OFF_RAD


@lru_cache(maxsize=4)
def _model(epoch: int) -> Any:
    from pygeomag import GeoMag

    return GeoMag(base_year=epoch)
