"""Where the aiding begins: with the heading by the field, or with one by velocity itself."""

from math import radians, sqrt
from typing import NamedTuple

from estimator.aiding import Report, begin
from estimator.aiding.search import EMPTY_SEARCH, solve
from estimator.aiding.types import NO_REPORT
from estimator.conditioning.types import ConditioningState
from estimator.filter.alignment import align
from estimator.geometry.quaternion import multiply
from estimator.live.conditioned import conditioned_vectors
from estimator.live.core import Core, flat
from estimator.live.settings import Settings
from estimator.live.snapshot import Snapshot
from estimator.types import Quaternion

# However small its computed sigma, a heading by velocity is no better than this to begin with.
LEAST_HEADING_SIGMA_RAD = radians(3.0)
# However long a gyroscope rests, its bias is known no better than this: streams carry mrad/s.
LEAST_BIAS_SIGMA_RAD_S = 0.001


class Start(NamedTuple):
    """Where the aiding begins."""

    q_ned_frd: Quaternion
    sigma_heading_rad: float


def start_by_field(settings: Settings, now: Core) -> Start:
    """The unaided attitude, which the field has given its heading."""
    q = align(conditioned_vectors(settings.reference, now.seen))
    return Start(q, settings.aiding.begin_heading_sigma_rad)


def start_by_velocity(now: Core) -> Start | None:
    """The attitude by velocity alone, if its heading is certain enough."""
    of_g = solve(now.search, _bias_sigma_rad_s(now.conditioning))
    if of_g is None:
        return None
    q = multiply(of_g.q_ned_g, now.conditioning.gravity.q_g_frd)
    return Start(q, max(of_g.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD))


def begin_again(settings: Settings, now: Snapshot) -> Core:
    """The core with the aiding at its beginning, from its own attitude and the last report.

    Velocity has borne that attitude out, so what contradicts it is the field, whose iron may be
    any, or the reports' past.
    """
    aided = now.core.aided
    report = NO_REPORT._replace(given=True, velocity_ned_m_s=aided.lean.latest_m_s)
    start = Start(aided.estimate.q_ned_frd, settings.aiding.begin_heading_sigma_rad)
    again = begin_aiding(settings, now, start, report, is_calibrated=False)
    return again._replace(aided=again.aided._replace(lean=aided.lean))


def begin_aiding(
    settings: Settings, now: Snapshot, start: Start, report: Report, *, is_calibrated: bool
) -> Core:
    """The core with the aiding at its beginning; iron may be small if the compass is calibrated."""
    core, aiding = now.core, settings.aiding
    aided, covariance, trail = begin(
        aiding,
        start.q_ned_frd,
        core.seen.bias_rad_s,
        core.sample,
        report,
        max(aiding.begin_tilt_sigma_rad, core.seen.sigma_inclination_rad),
        start.sigma_heading_rad,
        aiding.hard_iron_sigma_gauss if is_calibrated else aiding.uncalibrated_sigma_gauss,
    )
    return core._replace(
        aided=aided, covariance=flat(covariance), trail=flat(trail), search=EMPTY_SEARCH
    )


def _bias_sigma_rad_s(memory: ConditioningState) -> float:
    """How uncertain the conditioning stage's bias is, about the axis it knows least."""
    covariance = memory.estimate.covariance
    x, y, z = covariance[0], covariance[4], covariance[7]  # of the upper triangle of 4 by 4
    return max(sqrt(max(x, y, z)), LEAST_BIAS_SIGMA_RAD_S)
