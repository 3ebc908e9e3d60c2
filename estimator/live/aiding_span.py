"""Where the aiding begins and ends.

It begins with the heading by the field, or with one by velocity itself.
"""

from math import atan, atan2, copysign, dist, hypot, inf, isfinite, pi, remainder, sqrt, tan

import numpy as np

from estimator.aiding import compass
from estimator.aiding.acceleration_tilt import explains_acceleration
from estimator.aiding.beginning import Start, begin, inflate_covariance, lag_variance
from estimator.aiding.consistency import inflated
from estimator.aiding.course import forward_evidence, level_ahead, tilt_error_rad
from estimator.aiding.phase import Cause
from estimator.aiding.search import UNKNOWN_RAD, solve
from estimator.aiding.sources.velocity import is_credible
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import IMU_LAG, NO_REPORT, Report, Sigmas
from estimator.bounds import TINY
from estimator.conditioning.field.magnetic import horizontal_down
from estimator.conditioning.params import LONG_S
from estimator.conditioning.rate import slow_share
from estimator.conditioning.robust import HEADING_REACH_RAD, REACH
from estimator.conditioning.state import ConditioningState
from estimator.filter.alignment import align, quaternion_from_matrix
from estimator.geometry.earth import in_ned
from estimator.geometry.quaternion import (
    conjugate,
    cross,
    dot,
    exp,
    multiply,
    rotate,
    scale,
    shortest_rotation,
)
from estimator.live.aided import conditioned_vectors, is_worse
from estimator.live.core import Core, flat, in_rows, with_attitude
from estimator.live.iron import MOUNTED_RAD
from estimator.live.settings import Settings
from estimator.live.state import State
from estimator.types import DOWN, STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion

# However small its computed sigma, no heading is better known than this to begin with.
LEAST_HEADING_SIGMA_RAD = MOUNTED_RAD
# However long a gyroscope rests, its bias is known no better than this: streams carry mrad/s.
LEAST_BIAS_SIGMA_RAD_S = 0.001


def begin_aided(state: State, report: Report, *, has_heading: bool) -> None:
    """Velocity starts to help once there is a heading from true north.

    It comes from the field, or from velocity itself where there is no usable field
    or no position that shows true from magnetic north.
    """
    can_compare = has_heading and state.knows_north
    start = find_start_by_field(state) if can_compare else None
    if start is None:
        start = find_start_by_velocity(state, report)
        if start is None:
            state.enter(Cause.REPORT)
            return
        if can_compare and not rolls(state.settings.aiding):
            start = judge_field(state, start)
    # a field that is contradicted has shown no heading
    is_wrong = compass.is_contradicted(state.context.compass, state.core.time_us)
    set_out(state, start, report, has_heading=has_heading and not is_wrong)


def set_out(state: State, start: Start, report: Report, *, has_heading: bool) -> None:
    """Velocity helps from here on."""
    now = state.core.core
    aiding, iron_gauss = state.settings.aiding, iron_sigma_gauss(state, now)
    if rolls(aiding) and state.compass_is_usable:  # iron all around is none that turns along
        iron_gauss = aiding.hard_iron_sigma_gauss
    core = begin_aiding(state.settings, now, start, report, iron_gauss)
    if state.context.imu_lag_s is not None:
        core = with_imu_lag(core, state.context.imu_lag_s, state.context.acc_lead_s)
    if not has_heading or slow_share(core.sample.dt_s) > 0.0:
        # there was none to correct, or correcting it would take many slow steps
        core = with_attitude(core, start.q_ned_frd)
    state.set_core(core)
    state.change_context(is_by_field=start.turned_by_iron_1_gauss != ZERO_VEC3)
    state.enter(Cause.BEGIN)


def find_start_by_field(state: State) -> Start | None:
    """The heading by a field that is usable and settled, if that is known well enough.

    An uncalibrated compass begins it with a heading sigma of ``UNKNOWN_RAD``, so velocity turns the
    heading first. Only velocity makes that sigma smaller.
    """
    now = state.core.core  # taken out once: this takes longer than all that follows
    is_usable = field_is_usable(state, now)
    may_begin = is_usable or compass.is_unknown(state.context.compass, now.time_us)
    # the unaided vertical goes through its averaging time first
    age_s = now.conditioning.vertical.gravity.force.age_s
    if not may_begin or age_s < state.settings.conditioning.gravity_tau_s:
        return None
    if now.seen.sigma_heading_rad >= UNKNOWN_RAD:
        return None
    if not is_usable:
        start = start_by_field(state.settings, now, state.settings.aiding.hard_iron_sigma_gauss)
        return start._replace(heading_sigma_rad=UNKNOWN_RAD)
    start = start_by_field(state.settings, now, iron_sigma_gauss(state, now))
    return start if start.heading_sigma_rad < most_field_sigma_rad(state.settings, now) else None


def find_start_by_velocity(state: State, report: Report) -> Start | None:
    """The attitude that the reports show without any field, if its heading is certain enough."""
    if not state.core.search(report):
        return None
    now = state.core.core
    start = start_by_course(state.settings, now, report) if rolls(state.settings.aiding) else None
    of_g = solve(now.search, bias_sigma_rad_s(now.conditioning)) if start is None else None
    if of_g is None:
        return start
    q = multiply(of_g.q_ned_g, now.gathered.q_g_frd)
    return Start(q, max(of_g.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD))


def judge_field(state: State, start: Start) -> Start:
    """Whether the field contradicts a heading by velocity: then its compass is turned.

    A usable compass is not judged: it corrects a relative heading.
    """
    now, known = state.core.core, state.context.compass
    if compass.is_usable(known, now.time_us):
        return start
    seen, field = now.seen, now.conditioning.field.magnetic.reference
    by_tilt_rad = seen.sigma_inclination_rad * abs(field.down) / max(field.horizontal, TINY)
    field_rad = hypot(max(seen.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD), by_tilt_rad)
    q = align(conditioned_vectors(state.settings.reference, now.seen))
    off_rad = heading_between(q, start.q_ned_frd)
    sigma_rad = hypot(start.heading_sigma_rad, field_rad)
    if abs(off_rad) > REACH * sigma_rad:
        state.turn_compass(off_rad)
        return start._replace(compass_sigma_rad=UNKNOWN_RAD)
    if sigma_rad < 2.0 * LEAST_HEADING_SIGMA_RAD and compass.is_unknown(known, now.time_us):
        state.change_compass(confirmed=True)
    return start


def heading_between(q_ned_frd: Quaternion, other: Quaternion) -> float:
    """Angle (rad) about down from one attitude to another."""
    w, _, _, z = multiply(other, conjugate(q_ned_frd))
    return remainder(2.0 * atan2(z, w), 2.0 * pi)


def most_field_sigma_rad(settings: Settings, now: Core) -> float:
    """How uncertain a first heading by the field may be.

    A slow stream makes a wrong vertical of a wrong heading in a few steps, and corrects it as fast.
    Wheels show the heading within metres.
    """
    if slow_share(now.sample.dt_s) > 0.0:
        return UNKNOWN_RAD
    return inf if rolls(settings.aiding) else HEADING_REACH_RAD


def field_is_usable(state: State, now: Core) -> bool:
    """Whether the field may give the first heading: calibrated, and like the place's own."""
    place = state.place_field
    if place is not None:
        learnt = now.conditioning.field.magnetic.reference
        if not compass.resembles(place, learnt.horizontal, learnt.down):
            state.change_compass(unlike_us=now.time_us)
    return compass.is_usable(state.context.compass, now.time_us)


def iron_sigma_gauss(state: State, now: Core) -> float:
    """How large the vehicle's own field may be, on each axis.

    What calibration has left over is not known better than the field's strength and dip, two of its
    three components, lie off the place's. Without a calibration it may be all that is seen.
    """
    aiding, place = state.settings.aiding, state.place_field
    seen, known = now.conditioning.field.magnetic.reference, state.context.compass
    is_right = known.declared_calibrated is not False
    if not compass.is_usable(known._replace(declared_calibrated=is_right), now.time_us):
        return max(aiding.hard_iron_sigma_gauss, hypot(seen.horizontal, seen.down))
    if place is None:
        return aiding.hard_iron_sigma_gauss
    off = dist((seen.horizontal, seen.down), horizontal_down(in_ned(place)))
    return max(aiding.hard_iron_sigma_gauss, off / sqrt(2.0))


def give_up(state: State) -> None:
    """Measurements contradict the aided attitude, or it is lost: go on with the better known one.

    A contradicted aided attitude goes on with an inflated covariance, unless the unaided one is
    better known then: the reports or the field may be wrong. Where only its vertical is lost, its
    heading goes on with the unaided vertical. Giving up an attitude that seemed the better one is
    evidence against the compass that it began with, unless reports have just been missing for long.
    Where wheels contradict the heading that it began with, velocity shows it anew.
    """
    core = state.core.core
    if core.aided.wheels.contradict:
        state.change_compass(misled_us=core.time_us)
        state.enter(Cause.MISLED)
        return
    other = unaided_sigma(state, core)
    aided, covariance = core.aided, in_rows(core.covariance)
    if not is_credible(aided):
        aided, covariance = inflate_covariance(aided, covariance)
    is_consistent = explains_acceleration(aided.acceleration_tilt) and isfinite(hypot(*aided.sigma))
    # with what the unaided down and the field show against it
    inclination_rad = hypot(aided.sigma.inclination_rad, verticals_apart(core))
    sigma = Sigmas(inclination_rad, inflated(aided.sigma, core.consistency).heading_rad)
    has_lost_down = is_worse(core.aided, core.seen) and not is_consistent
    if is_consistent or (is_better(sigma, other) and not has_lost_down):
        state.set_core(core._replace(aided=aided, covariance=flat(covariance)))
        return
    if has_lost_down:
        start = start_level(core, sigma.heading_rad)
        if start.heading_sigma_rad < min(other.heading_rad, UNKNOWN_RAD):
            report = NO_REPORT._replace(velocity_ned_m_s=aided.acceleration_tilt.latest_m_s)
            state.enter(Cause.GIVE_UP)
            set_out(state, start, report, has_heading=core.seen.has_heading)
            return
    if core.consistency.report_wait_s <= LONG_S and is_better(core.aided.sigma, other):
        known = compass.record_giving_up(state.context.compass, core.time_us)
        state.change_context(compass=known)
    state.enter(Cause.GIVE_UP)
    is_lost = not isfinite(sum(core.filter.q_ned_frd))
    if is_lost or (core.seen.has_heading and slow_share(core.sample.dt_s) > 0.0):
        state.align()


def verticals_apart(now: Core) -> float:
    """Angle (rad) between the aided down and the unaided one."""
    down = rotate(now.aided.estimate.q_ned_frd, now.seen.gravity_b)
    return atan2(hypot(down[0], down[1]), down[2])


def unaided_sigma(state: State, now: Core) -> Sigmas:
    """How well the attitude is known without velocity."""
    seen = now.seen
    heading_rad = seen.sigma_heading_rad if seen.has_heading else pi
    if not state.compass_is_usable:
        heading_rad = max(heading_rad, UNKNOWN_RAD)
    return Sigmas(seen.sigma_inclination_rad, heading_rad)


def is_better(one: Sigmas, other: Sigmas) -> bool:
    """Whether an attitude is known better than another one; one that is no number never is."""
    return hypot(*one) < hypot(*other)


def start_by_field(settings: Settings, now: Core, iron_gauss: float) -> Start:
    """The unaided attitude, which the field has given its heading: the iron's error is in it."""
    q = align(conditioned_vectors(settings.reference, now.seen))
    seen_gauss = now.conditioning.field.magnetic.reference.horizontal
    per_gauss = 1.0 / max(seen_gauss, TINY)
    sigma_rad = max(LEAST_HEADING_SIGMA_RAD, now.seen.sigma_heading_rad, iron_gauss * per_gauss)
    east = cross(now.seen.gravity_b, now.seen.magnetic_b)
    return Start(q, sigma_rad, turned_by_iron_1_gauss=scale(per_gauss, east))


def start_level(now: Core, sigma_heading_rad: float) -> Start:
    """The aided attitude turned to the unaided vertical by the shortest way, a.

    An error of the heading makes the true turn one about an axis that is as far out of level as it
    is large beside a. So the heading is off by 2 atan(error tan(a/2) / a): of one that was upside
    down nothing is left.
    """
    q, apart = now.aided.estimate.q_ned_frd, max(verticals_apart(now), TINY)
    level = shortest_rotation(rotate(q, now.seen.gravity_b), DOWN)
    off_rad = 2.0 * atan(sigma_heading_rad * tan(0.5 * apart) / apart)
    return Start(multiply(level, q), off_rad)


def start_by_course(settings: Settings, now: Core, report: Report) -> Start | None:
    """The unaided vertical with the heading by where it rolls, if it is clear which way that is.

    The reported course is as old as the report; the vehicle has turned on since.
    """
    aiding, down, rolled = settings.aiding, now.seen.gravity_b, now.search.evidence.rolled
    forward = forward_evidence(rolled)
    north, east, _ = report.velocity_ned_m_s
    speed, level = hypot(north, east), hypot(down[1], down[2])
    if level * speed == 0.0 or abs(forward) < REACH**2:
        return None
    unsure = max(report.sigma_m_s, aiding.report_sigma_m_s) / speed
    sense = copysign(1.0, forward)
    tilt_rad = hypot(now.seen.sigma_inclination_rad, tilt_error_rad(rolled, sense))
    sigma_rad = hypot(unsure, aiding.sideslip_rad, tilt_rad * down[0] / level)
    if sigma_rad > UNKNOWN_RAD:
        return None
    age_s = report.ago_s + report.late_sigma_s - aiding.imu_lag_s
    heading_rad = atan2(sense * east, sense * north) + age_s * dot(now.seen.rate_rad_s, down)
    ahead = level_ahead(down)
    q_level_frd = quaternion_from_matrix(np.array([ahead, cross(down, ahead), down]))
    return Start(multiply(exp((0.0, 0.0, heading_rad)), q_level_frd), sigma_rad, tilt_rad)


def with_imu_lag(core: Core, lag_s: float, lead_s: float) -> Core:
    """The core with other ages of the IMU's samples, as uncertain as at the beginning."""
    estimate = core.aided.estimate._replace(imu_lag_s=lag_s, acc_lead_s=lead_s)
    P = in_rows(core.covariance)
    P[IMU_LAG, :] = P[:, IMU_LAG] = 0.0
    P[IMU_LAG, IMU_LAG] = lag_variance(lag_s)
    return core._replace(aided=core.aided._replace(estimate=estimate), covariance=flat(P))


def begin_aiding(
    settings: Settings, core: Core, start: Start, report: Report, iron_gauss: float
) -> Core:
    """The core with the aiding at its beginning, and the vehicle's own field as uncertain."""
    aiding = settings.aiding
    # either sensor's bias may have tilted the vertical
    drift_rad_s = start.tilt_sigma_rad / settings.conditioning.gravity_tau_s
    push_m_s2 = start.tilt_sigma_rad * STANDARD_GRAVITY_M_S2
    aided, covariance, velocity_history = begin(
        aiding._replace(
            gyr_bias_sigma=max(aiding.gyr_bias_sigma, drift_rad_s),
            acc_bias_sigma=max(aiding.acc_bias_sigma, push_m_s2),
        ),
        start._replace(
            tilt_sigma_rad=max(core.seen.sigma_inclination_rad, start.tilt_sigma_rad),
            gyr_bias_rad_s=core.seen.bias_rad_s,
            hard_iron_sigma_gauss=iron_gauss,
            field_lag_s=settings.conditioning.field_lag_sigma_s,
        ),
        core.sample,
        report,
    )
    aided = aided._replace(wheels=core.aided.wheels)
    return core._replace(
        aided=aided,
        covariance=flat(covariance),
        velocity_history=flat(velocity_history),
        search=core.search,
    )


def bias_sigma_rad_s(memory: ConditioningState) -> float:
    """How uncertain the conditioning stage's bias is, about the axis it knows least."""
    covariance = memory.vertical.estimate.covariance
    x, y, z = covariance[0], covariance[4], covariance[7]  # of the upper triangle of 4 by 4
    return max(sqrt(max(x, y, z)), LEAST_BIAS_SIGMA_RAD_S)
