"""Where the aiding begins and ends.

It begins with the heading by the field, or with one by velocity itself.
"""

from math import radians, sqrt
from typing import NamedTuple

from estimator.aiding import Report, begin, compass
from estimator.aiding.lean import bears_out
from estimator.aiding.phase import Cause
from estimator.aiding.place import resembles
from estimator.aiding.search import EMPTY_SEARCH, solve
from estimator.aiding.types import NO_REPORT
from estimator.conditioning import ConditioningState
from estimator.conditioning.vertical.rate import slow_share
from estimator.filter.alignment import align
from estimator.geometry.quaternion import multiply
from estimator.live.conditioned import conditioned_vectors
from estimator.live.core import Core, flat, with_attitude
from estimator.live.settings import Settings
from estimator.live.state import State
from estimator.types import Quaternion

# However small its computed sigma, a heading by velocity is no better than this to begin with.
LEAST_HEADING_SIGMA_RAD = radians(3.0)
# However long a gyroscope rests, its bias is known no better than this: streams carry mrad/s.
LEAST_BIAS_SIGMA_RAD_S = 0.001


def begin_aided(state: State, report: Report, *, has_heading: bool) -> None:
    """Velocity starts to help once there is a heading from true north.

    It comes from the field, or from velocity itself where there is no field to be trusted
    or no position that tells true from magnetic north.
    """
    start: Start | None = None
    if has_heading and state.knows_north and trusts_field(state) and is_settled(state):
        start = start_by_field(state.settings, state.core.core)
    elif state.core.search(report):
        start = start_by_velocity(state.core.core)
    if start is None:
        state.enter(Cause.REPORT)
        return
    is_calibrated = compass.is_trusted(state.context.compass, state.core.time_us)
    core = begin_aiding(state.settings, state.core.core, start, report, is_calibrated=is_calibrated)
    if not has_heading or slow_share(core.sample.dt_s) > 0.0:
        # there was none to correct, or correcting it would take many slow steps
        core = with_attitude(core, start.q_ned_frd)
    state.set_core(core)
    state.enter(Cause.BEGIN)


def is_settled(state: State) -> bool:
    """Whether the unaided vertical has gone through its averaging time since it began."""
    age_s = state.core.core.conditioning.vertical.gravity.force.age_s
    return age_s >= state.settings.conditioning.gravity_tau_s


def trusts_field(state: State) -> bool:
    """Whether the field may give the first heading: calibrated, and like the place's own."""
    place = state.place_field
    if place is not None:
        learnt = state.core.core.conditioning.field.magnetic.reference
        if not resembles(place, learnt.horizontal, learnt.down):
            known = state.context.compass._replace(unlike_us=state.core.time_us)
            state.change_context(compass=known)
    return compass.is_trusted(state.context.compass, state.core.time_us)


def give_up(state: State) -> None:
    """Velocity does not help any more; the compass may be the reason.

    An attitude that the reports' acceleration bears out is no reason to fall back on the
    unaided one: then the aiding begins anew from its own.
    """
    core = state.core.core
    if bears_out(core.aided.lean):
        state.set_core(begin_again(state.settings, core))
        return
    known = compass.record_giving_up(state.context.compass, core.time_us)
    state.change_context(compass=known)
    state.enter(Cause.GIVE_UP)
    if core.seen.has_heading and slow_share(core.sample.dt_s) > 0.0:
        state.align()


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
    q = multiply(of_g.q_ned_g, now.conditioning.vertical.gravity.q_g_frd)
    return Start(q, max(of_g.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD))


def begin_again(settings: Settings, now: Core) -> Core:
    """The core with the aiding at its beginning, from its own attitude and the last report.

    Velocity has borne that attitude out, so what contradicts it is the field, whose iron may be
    any, or the reports' past.
    """
    aided = now.aided
    report = NO_REPORT._replace(given=True, velocity_ned_m_s=aided.lean.latest_m_s)
    start = Start(aided.estimate.q_ned_frd, settings.aiding.begin_heading_sigma_rad)
    again = begin_aiding(settings, now, start, report, is_calibrated=False)
    return again._replace(aided=again.aided._replace(lean=aided.lean))


def begin_aiding(
    settings: Settings, core: Core, start: Start, report: Report, *, is_calibrated: bool
) -> Core:
    """The core with the aiding at its beginning; iron may be small if the compass is calibrated."""
    aiding = settings.aiding
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
    covariance = memory.vertical.estimate.covariance
    x, y, z = covariance[0], covariance[4], covariance[7]  # of the upper triangle of 4 by 4
    return max(sqrt(max(x, y, z)), LEAST_BIAS_SIGMA_RAD_S)
