"""Places on the earth, and the magnetic field there, from the World Magnetic Model."""

from functools import lru_cache
from math import cos, dist, isfinite, radians, sin
from typing import Any, NamedTuple

from estimator.types import Vec3

SECONDS_A_YEAR = 365.25 * 86_400.0
UNIX_EPOCH_YEAR = 1970.0
# The years that the models at hand describe; a clock that is far off gets the nearest one.
FIRST_YEAR = 2010.0
LAST_YEAR = 2030.0
LATITUDE_LIMIT_DEG = 89.9  # at the poles the declination is undefined
NANOTESLA_PER_GAUSS = 1e5
EARTH_RADIUS_M = 6_371_000.0


class PlaceField(NamedTuple):
    """Declination (east positive) and dip (down positive) in rad, and the field's strength."""

    declination_rad: float
    dip_rad: float
    strength_gauss: float


def in_ned(field: PlaceField) -> Vec3:
    """The field in NED, gauss."""
    horizontal = field.strength_gauss * cos(field.dip_rad)
    return (
        horizontal * cos(field.declination_rad),
        horizontal * sin(field.declination_rad),
        field.strength_gauss * sin(field.dip_rad),
    )


def distance_m(one_deg: tuple[float, float], other_deg: tuple[float, float]) -> float:
    """The chord between two places (latitude, longitude) on a sphere."""
    return EARTH_RADIUS_M * dist(_direction(*one_deg), _direction(*other_deg))


def _direction(latitude_deg: float, longitude_deg: float) -> tuple[float, float, float]:
    latitude, longitude = radians(latitude_deg), radians(longitude_deg)
    across = cos(latitude)
    return (across * cos(longitude), across * sin(longitude), sin(latitude))


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
        glon=longitude_deg,
        alt=1e-3 * altitude_m,
        time=year,
        allow_date_outside_lifespan=True,
    )
    return PlaceField(
        radians(float(result.d)),
        radians(float(result.i)),
        float(result.f) / NANOTESLA_PER_GAUSS,
    )


@lru_cache(maxsize=4)
def _model(epoch: int) -> Any:
    from pygeomag import GeoMag

    return GeoMag(base_year=epoch)
