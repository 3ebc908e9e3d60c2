"""Whether a compass may give the heading: what is known about its calibration, and since when.

It needs a declaration that it is calibrated, or a heading that velocity has confirmed. Evidence
against it is a declaration that it is not calibrated, a field unlike the place's, a heading that
velocity contradicts, or two failures of the aiding in a row. A declaration holds until the next
one. Other evidence expires: a vehicle may have stood beside iron, or tilted.
"""

from math import dist
from typing import NamedTuple

from estimator.conditioning.field.magnetic import NORM_SCALE, horizontal_down
from estimator.conditioning.params import FORGET_S, LONG_S, MEMORY_S, MOST_DEVIATION
from estimator.geometry.earth import PlaceField, in_ned
from estimator.types import EVER_US, NEVER_US

# A compass whose heading was wrong twice within LONG_S counts as not calibrated for FORGET_S. After
# a field unlike the place's own, the field must look like it for MEMORY_S.


class Compass(NamedTuple):
    """What is known about a compass; times are the vehicle's, None for what never happened."""

    declared_calibrated: bool | None = None  # the last declaration; None: there was none
    unlike_us: int | None = None  # when its field last did not look like the place's own
    gave_up_us: int | None = None  # when the aiding last gave up
    misled_us: int | None = None  # when it last gave up for the second time in a row
    contradicted_us: int | None = None  # when velocity itself showed that its heading is wrong
    turned_rad: float = 0.0  # by which it is turned in the vehicle about down, and read so
    confirmed: bool = False  # velocity has shown the heading that it gives, read so
    contradicted_since_us: int | None = None  # velocity itself shows another heading


CONTRADICTED = "velocity contradicts the compass"
NOT_DECLARED = "nobody has declared the compass calibrated"


def is_usable(compass: Compass, time_us: int) -> bool:
    """Whether nothing counts against its field at ``time_us``."""
    return not evidence_against(compass, time_us)


def is_contradicted(compass: Compass, time_us: int) -> bool:
    """Whether velocity has shown that it is not mounted, or not calibrated, as declared."""
    return compass.turned_rad != 0.0 or _is_recent(compass.contradicted_us, time_us, FORGET_S)


def evidence_against(compass: Compass, time_us: int) -> str:
    """The evidence against it at ``time_us``, in words; empty if there is none."""
    if compass.declared_calibrated is None and not compass.confirmed:
        return NOT_DECLARED
    if compass.declared_calibrated is False:
        return "nobody has calibrated the compass"
    if _is_recent(compass.misled_us, time_us, FORGET_S):
        return "the compass has misled twice"
    if is_contradicted(compass, time_us) and not compass.confirmed:
        return CONTRADICTED
    return "the field is not like this place's" * _is_recent(compass.unlike_us, time_us, MEMORY_S)


def rejected_until_us(compass: Compass) -> int:
    """Until when something that was seen is evidence against it."""
    if compass.turned_rad != 0.0 and not compass.confirmed:
        return EVER_US
    return max(
        _until_us(compass.misled_us, FORGET_S),
        NEVER_US if compass.confirmed else _until_us(compass.contradicted_us, FORGET_S),
        _until_us(compass.unlike_us, MEMORY_S),
    )


def used_from_us(compass: Compass) -> int:
    """The time from which its field counts."""
    if compass.turned_rad != 0.0:
        return NEVER_US  # it is read as it is mounted
    return _until_us(compass.contradicted_us, FORGET_S)


def _until_us(then_us: int | None, for_s: float) -> int:
    return NEVER_US if then_us is None else then_us + round(1e6 * for_s)


def is_unknown(compass: Compass, time_us: int) -> bool:
    """Whether nothing is known for or against it, by declaration or by velocity."""
    is_open = compass.declared_calibrated is None and not compass.confirmed
    return is_open and is_usable(compass._replace(declared_calibrated=True), time_us)


def declare(compass: Compass, is_calibrated: bool) -> Compass:
    """After a declaration about its calibration; only a new one clears what was seen before."""
    if is_calibrated == compass.declared_calibrated:
        return compass
    return Compass(declared_calibrated=is_calibrated, turned_rad=compass.turned_rad)


def record_giving_up(compass: Compass, time_us: int) -> Compass:
    """After the aiding has given up; the second time in a row is evidence against the compass."""
    if _is_recent(compass.gave_up_us, time_us, LONG_S):
        compass = compass._replace(misled_us=time_us)
    return compass._replace(gave_up_us=time_us)


def restart(compass: Compass) -> Compass:
    """After a reboot. The clock begins anew, so only declarations and its mounting hold."""
    return Compass(compass.declared_calibrated, turned_rad=compass.turned_rad)


def _is_recent(then_us: int | None, time_us: int, for_s: float) -> bool:
    return then_us is not None and time_us - then_us < 1e6 * for_s


def differ(one: PlaceField, other: PlaceField) -> bool:
    """Whether two places' fields differ by more than a calibration leaves; 200 km do less."""
    return dist(in_ned(one), in_ned(other)) > NORM_SCALE * one.strength_gauss


def resembles(place: PlaceField, horizontal_gauss: float, down_gauss: float) -> bool:
    """Whether a field seen there may be the place's own: a compass that is calibrated sees it so.

    Some autopilots' scale is half of reality.
    """
    own = horizontal_down(in_ned(place))
    return dist((horizontal_gauss, down_gauss), own) <= MOST_DEVIATION * place.strength_gauss
