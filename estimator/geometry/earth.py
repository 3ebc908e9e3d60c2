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
    """The field at a place and a date; None where the model has none.

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
        radians(float(result.d)), radians(float(result.i)), float(result.f) / NANOTESLA_PER_GAUSS
    )


@lru_cache(maxsize=4)
def _model(epoch: int) -> Any:
    from pygeomag import GeoMag

    return GeoMag(base_year=epoch)


# So far away the field is looked up anew; the declination changes by some 0.1 degrees in that.
MOVED_M = 20_000.0


class Place(NamedTuple):
    """A place whose field has been looked up."""

    latitude_deg: float
    longitude_deg: float
    field: PlaceField


class LastPosition(NamedTuple):
    """Where the vehicle is taken to be, and another place that was reported just now."""

    here: Place | None = None
    elsewhere_deg: tuple[float, float] | None = None


def update_position(
    known: LastPosition, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
) -> LastPosition:
    """The place after one more position.

    The first one counts. After that two reports in a row must be more than ``MOVED_M`` away, so
    that one bad position moves nothing.
    """
    here, position = known.here, (latitude_deg, longitude_deg)
    if not (isfinite(latitude_deg) and isfinite(longitude_deg)):
        return known
    if here is not None:
        if distance_m((here.latitude_deg, here.longitude_deg), position) < MOVED_M:
            return known if known.elsewhere_deg is None else known._replace(elsewhere_deg=None)
        before = known.elsewhere_deg
        if before is None or distance_m(before, position) > MOVED_M:
            return known._replace(elsewhere_deg=position)
    field = field_at(latitude_deg, longitude_deg, altitude_m, unix_us)
    return known if field is None else LastPosition(Place(*position, field))
