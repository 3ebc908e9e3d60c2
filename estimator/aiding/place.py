"""Where a vehicle is taken to be, and whether a field may be that of the place."""

from math import dist, isfinite
from typing import NamedTuple

from estimator.conditioning.field.magnetic import NORM_SCALE, horizontal_down
from estimator.conditioning.robust import MOST_DEVIATION
from estimator.geometry.earth import PlaceField, distance_m, field_at, in_ned

# So far away the field is looked up anew; the declination changes by some 0.1 degrees in that.
MOVED_M = 20_000.0


class Place(NamedTuple):
    """A place whose field has been looked up."""

    latitude_deg: float
    longitude_deg: float
    field: PlaceField


class LastPosition(NamedTuple):
    """Where the vehicle is taken to be, and somewhere else it was said to be just now."""

    here: Place | None = None
    elsewhere_deg: tuple[float, float] | None = None


def update_whereabouts(
    known: LastPosition, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
) -> LastPosition:
    """After a position was told.

    The first one counts. After that a place more than ``MOVED_M`` away must be told twice in a
    row, so that one bad position moves nothing.
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


def differ(one: PlaceField, other: PlaceField) -> bool:
    """Whether two places' fields differ by more than a calibration leaves; 200 km do less."""
    return dist(in_ned(one), in_ned(other)) > NORM_SCALE * one.strength_gauss


def resembles(place: PlaceField, horizontal_gauss: float, down_gauss: float) -> bool:
    """Whether a field seen there may be the place's own: a compass that is calibrated sees it so.

    Some autopilots' scale is half of reality.
    """
    own = horizontal_down(in_ned(place))
    return dist((horizontal_gauss, down_gauss), own) <= MOST_DEVIATION * place.strength_gauss
