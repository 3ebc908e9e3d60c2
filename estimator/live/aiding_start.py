"""How velocity begins to help: at the field's heading, or at the one that velocity has shown."""

from math import radians, sqrt
from typing import NamedTuple

from estimator.aiding import Report, begin, compass
from estimator.aiding.search import EMPTY_SEARCH, solve
from estimator.conditioning.types import ConditioningState
from estimator.filter.alignment import align
from estimator.geometry.quaternion import multiply
from estimator.live.conditioned import conditioned_vectors
from estimator.live.settings import Settings
from estimator.live.snapshot import Snapshot, flat
from estimator.types import ImuSample, Quaternion

# A heading that velocity has shown is no better than this to begin with.
LEAST_HEADING_SIGMA_RAD = radians(3.0)
# However long a gyroscope rests, its bias is no better known: streams truncate to mrad/s.
LEAST_BIAS_SIGMA_RAD_S = 0.001


class Start(NamedTuple):
    """Where the aiding begins."""

    q_ned_frd: Quaternion
    sigma_heading_rad: float


def start_by_field(settings: Settings, now: Snapshot) -> Start:
    """The unaided attitude, which the field has given its heading."""
    assert now.seen is not None  # a sample has been conditioned
    q = align(conditioned_vectors(settings.reference, now.seen))
    return Start(q, settings.aiding.begin_heading_sigma_rad)


def start_by_velocity(now: Snapshot) -> Start | None:
    """What velocity alone has shown, if that is enough."""
    of_g = solve(now.search, _bias_sigma_rad_s(now.conditioning))
    if of_g is None:
        return None
    q = multiply(of_g.q_ned_g, now.conditioning.gravity.q_g_frd)
    return Start(q, max(of_g.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD))


def begin_aiding(
    settings: Settings,
    now: Snapshot,
    start: Start,
    sample: ImuSample,
    report: Report,
    *,
    is_first_heading: bool,
) -> Snapshot:
    """The snapshot with the aiding at its beginning; a first heading is the filter's at once."""
    aiding, seen = settings.aiding, now.seen
    assert seen is not None  # a sample has been conditioned
    is_calibrated = compass.is_trusted(now.compass, now.time_us)
    aided, covariance = begin(
        aiding,
        start.q_ned_frd,
        seen.bias_rad_s,
        sample.gyr_rad_s,
        sample.acc_m_s2,
        report,
        start.sigma_heading_rad,
        aiding.hard_iron_sigma_gauss if is_calibrated else aiding.uncalibrated_sigma_gauss,
    )
    now = now._replace(aided=aided, aided_covariance=flat(covariance), search=EMPTY_SEARCH)
    if is_first_heading:  # there was none to correct
        now = now._replace(filter=now.filter._replace(q_ned_frd=start.q_ned_frd))
    return now


def _bias_sigma_rad_s(memory: ConditioningState) -> float:
    """How uncertain the conditioning stage's bias is, about the axis it knows least."""
    covariance = memory.estimate.covariance
    x, y, z = covariance[0], covariance[4], covariance[7]  # of the upper triangle of 4 by 4
    return max(sqrt(max(x, y, z)), LEAST_BIAS_SIGMA_RAD_S)
