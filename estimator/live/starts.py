"""With what attitude the aiding may begin: by the field, by velocity, or by both."""

from math import atan, atan2, copysign, dist, hypot, inf, pi, remainder, sqrt, tan

import numpy as np

from estimator.aiding import compass
from estimator.aiding.beginning import Start
from estimator.aiding.course import forward_evidence, level_ahead, tilt_error_rad
from estimator.aiding.push_and_field import PushAndField, solve_with_field
from estimator.aiding.search import UNKNOWN_RAD, Solution, solve
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import Report, Sigmas
from estimator.bounds import TINY
from estimator.conditioning.field.magnetic import NORM_SCALE, horizontal_down
from estimator.conditioning.params import HEADING_REACH_RAD, LATELY_S, LONGEST_STEP_S, REACH, SPAN_S
from estimator.conditioning.rate import slow_share
from estimator.conditioning.state import ConditioningState
from estimator.filter.alignment import align, quaternion_from_matrix
from estimator.geometry.earth import in_ned
from estimator.geometry.quaternion import (
    conjugate,
    cross,
    dot,
    exp,
    multiply,
    norm,
    rotate,
    rotate_inverse,
    scale,
    shortest_rotation,
)
from estimator.live.aided import conditioned_vectors
from estimator.live.core import Core
from estimator.live.settings import Settings
from estimator.live.situation import MOUNTED_RAD
from estimator.live.state import State
from estimator.types import DOWN, Quaternion

# However small its computed sigma, no heading is better known than this to begin with.
LEAST_HEADING_SIGMA_RAD = MOUNTED_RAD
# However long a gyroscope rests, its bias is known no better than this: streams carry mrad/s.
LEAST_BIAS_SIGMA_RAD_S = 0.001


def find_start_by_field(state: State) -> Start | None:
    """The heading by a field that is usable and settled, if that is known well enough.

    An uncalibrated compass begins it with a heading sigma of ``UNKNOWN_RAD``, so velocity turns the
    heading first. Only velocity makes that sigma smaller.
    """
    now = state.core  # taken out once: this takes longer than all that follows
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


def see_push_and_field(state: State, now: Core, report: Report) -> PushAndField | None:
    """The last push and the place's field, if both may show the attitude.

    It needs a gyroscope that nothing contradicts, steps in which it misses little of the turning,
    and a report that shows the vertical part.
    """
    aiding, place = state.settings.aiding, state.settings.reference.place_gauss
    events, evidence = now.conditioning.events, now.search.evidence
    is_followed = evidence.latest.longest_step_s < LONGEST_STEP_S
    is_carried = is_followed and events.axes.since_s >= LATELY_S
    is_seen = now.seen.has_heading and now.conditioning.field.magnetic.wait_s < SPAN_S
    if not is_carried or not is_seen or not state.knows_north or norm(place) == 0.0:
        return None
    if not report.has_vertical or not state.compass_is_usable:
        return None
    sigma_m_s = aiding.receiver_noise_m_s * max(1.0, report.sigma_m_s / aiding.report_sigma_m_s)
    return PushAndField(
        push=evidence.latest,
        change_sigma_m_s=sqrt(2.0) * sigma_m_s,  # of the window's two reports
        late_sigma_s=hypot(evidence.late_sigma_s, aiding.imu_lag_s),
        field_ned=place,
        field_g=events.jump.quick,
        field_sigma_rad=max(NORM_SCALE, iron_sigma_gauss(state, now) / norm(place)),
    )


def find_start_by_both(state: State, now: Core, seen: PushAndField | None) -> Start | None:
    """The attitude by the last push and the place's field, whatever it was before."""
    found = None if seen is None else solve_with_field(seen)
    if seen is None or found is None:
        return None
    start, per_gauss = start_from(found, now), 1.0 / max(horizontal_down(seen.field_ned)[0], TINY)
    east = rotate_inverse(start.q_ned_frd, (0.0, 1.0, 0.0))
    return start._replace(
        heading_sigma_rad=max(start.heading_sigma_rad, iron_sigma_gauss(state, now) * per_gauss),
        turned_by_iron_1_gauss=scale(per_gauss, east),
    )


def start_from(found: Solution, now: Core) -> Start:
    """The body's attitude where that of G was found."""
    q = multiply(found.q_ned_g, now.gathered.q_g_frd)
    return Start(q, max(found.sigma_heading_rad, LEAST_HEADING_SIGMA_RAD), found.sigma_tilt_rad)


def find_start_by_velocity(state: State, now: Core, report: Report) -> Start | None:
    """The attitude that the reports show without any field, if its heading is certain enough."""
    start = start_by_course(state.settings, now, report) if rolls(state.settings.aiding) else None
    found = solve(now.search, bias_sigma_rad_s(now.conditioning)) if start is None else None
    return start if found is None else start_from(found, now)


def judge_field(state: State, start: Start) -> Start:
    """Whether the field contradicts an attitude by velocity: then its compass is turned.

    Unless velocity has confirmed it before, the compass may be turned by any angle.
    """
    now, known = state.core, state.context.compass
    if known.confirmed:
        return start
    tilt_rad = start.tilt_sigma_rad or now.seen.sigma_inclination_rad
    q_ned_g = multiply(start.q_ned_frd, conjugate(now.gathered.q_g_frd))
    found = Solution(q_ned_g, start.heading_sigma_rad, tilt_rad)
    turn_rad, sigma_rad = compass_turn(state, now, found)
    if abs(turn_rad) > REACH * sigma_rad:
        state.turn_compass(turn_rad)
    elif sigma_rad < 2.0 * LEAST_HEADING_SIGMA_RAD and compass.is_unknown(known, now.time_us):
        state.change_compass(confirmed=True)
        return start
    return start._replace(compass_sigma_rad=pi)


def compass_turn(state: State, now: Core, found: Solution) -> tuple[float, float]:
    """By how much (rad, about down) the field of the last second is off north, and its sigma.

    This uses velocity only: the aiding may have learnt a turned compass as iron.
    """
    north, field = state.settings.reference.magnetic_ned, now.conditioning.field.magnetic.reference
    F = rotate(found.q_ned_g, now.conditioning.events.jump.slow)
    turn_rad = atan2(north[0] * F[1] - north[1] * F[0], north[0] * F[0] + north[1] * F[1])
    iron_rad = iron_sigma_gauss(state, now) / max(field.horizontal, TINY)
    by_tilt_rad = found.sigma_tilt_rad * abs(field.down) / max(field.horizontal, TINY)
    return turn_rad, hypot(found.sigma_heading_rad, MOUNTED_RAD, iron_rad, by_tilt_rad)


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
    return Start(
        multiply(exp((0.0, 0.0, heading_rad)), q_level_frd),
        sigma_rad,
        tilt_rad,
        tilt_by_bias_rad=tilt_rad,
    )


def bias_sigma_rad_s(memory: ConditioningState) -> float:
    """How uncertain the conditioning stage's bias is, about the axis it knows least."""
    covariance = memory.vertical.estimate.covariance
    x, y, z = covariance[0], covariance[4], covariance[7]  # of the upper triangle of 4 by 4
    return max(sqrt(max(x, y, z)), LEAST_BIAS_SIGMA_RAD_S)
