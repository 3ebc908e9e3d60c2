"""What the steps know of the context: the vectors' source, and how the compass stands."""

from math import acos, cos, radians, sqrt
from typing import NamedTuple

from estimator.aiding.search import UNKNOWN_RAD
from estimator.compilation.compiled import inlined
from estimator.conditioning.field.calibration import most_variances
from estimator.conditioning.field.magnetic import NORM_SCALE, deviation, horizontal_down, norm_of
from estimator.conditioning.params import ConditioningParams
from estimator.conditioning.state import ConditioningState
from estimator.types import NEVER_US, Vec3

# What the filter's vectors come from.
RAW, CONDITIONED, AIDED = range(3)

# The standing of the compass: velocity has confirmed its heading; it is declared calibrated; it is
# not declared, but turns may show its iron; there is evidence against it that turns cannot refute.
PROVEN, VOUCHED, BY_TURNS, CONTRADICTED = range(4)
# A compass that is declared calibrated is mounted this well, rad: only velocity shows more.
MOUNTED_RAD = radians(5.0)


class Situation(NamedTuple):
    """The part of the context that the steps need, see :mod:`estimator.live.core`."""

    source: int = RAW
    standing: int = VOUCHED  # of the compass
    rejected_until_us: int = NEVER_US  # until when that is ``CONTRADICTED``
    used_from_us: int = NEVER_US  # from when on the field counts
    knows_north: bool = False
    turned_back: tuple[float, float] = (1.0, 0.0)  # cosine and sine of the compass's own turn
    watches_gaps: bool = False
    north: int = 0  # the place in ``NORTHS`` of what a heading by the field is measured from
    north_without: int = 0  # and of one without


@inlined
def standing_at(now: Situation, time_us: int) -> int:
    """How the compass stands at a time."""
    return CONTRADICTED if time_us < now.rejected_until_us else now.standing


@inlined
def mounted_rad(standing: int) -> float:
    """How far (rad) the compass that the aiding began with may be turned in the vehicle."""
    if standing == PROVEN:
        return 0.0
    return MOUNTED_RAD if standing == VOUCHED else UNKNOWN_RAD


@inlined
def unshown_iron(
    params: ConditioningParams, memory: ConditioningState, place_gauss: Vec3, standing: int
) -> float:
    """How far (rad) iron that nothing has shown may turn the heading; ``UNKNOWN_RAD`` at most.

    For a compass that is declared calibrated it is what the place's dip contradicts beyond the
    errors of calibrations; some autopilots' scale is not in gauss. For one that is not declared the
    turns' own information counts: that of the learnt offset
    (:mod:`estimator.conditioning.field.calibration`) less the prior. With its least eigenvalue l, s
    = norm / (H sqrt l). Turns refute no other fault.
    """
    seen = memory.field.magnetic.reference
    h, norm = seen.horizontal, norm_of((seen.horizontal, seen.down))
    if standing <= VOUCHED:
        place = horizontal_down(place_gauss)
        if h <= 0.0 or norm_of(place) == 0.0:
            return 0.0
        _, off_dip = deviation((h, seen.down), place)
        square = max(0.0, off_dip * off_dip - NORM_SCALE * NORM_SCALE)
        return min(UNKNOWN_RAD, norm * sqrt(0.5 * square) / h)
    most = most_variances(params)[0]
    if standing != BY_TURNS or most <= 0.0 or h <= 0.0:
        return UNKNOWN_RAD
    p = memory.field.calibration.learnt.covariance
    least = 1.0 / largest_eigenvalue((p[0], p[4], p[7]), (p[5], p[2], p[1])) - 1.0 / most
    if least <= 0.0:
        return UNKNOWN_RAD
    return min(UNKNOWN_RAD, norm / (h * sqrt(least)))


@inlined
def largest_eigenvalue(diagonal: Vec3, beside: Vec3) -> float:
    """That of a symmetric 3 x 3 matrix, with ``beside`` its yz, xz and xy (O. K. Smith 1961)."""
    x, y, z = diagonal
    yz, xz, xy = beside
    mean = (x + y + z) / 3.0
    a, b, c = x - mean, y - mean, z - mean
    size = sqrt((a * a + b * b + c * c + 2.0 * (yz * yz + xz * xz + xy * xy)) / 6.0)
    if size <= 0.0:
        return mean
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    third = acos(max(-1.0, min(1.0, 0.5 * det / size**3))) / 3.0
    return mean + 2.0 * size * cos(third)
