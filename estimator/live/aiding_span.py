"""Where the aiding begins and ends, and where it begins anew."""

from math import hypot, isfinite, sqrt

from estimator.aiding import compass
from estimator.aiding.acceleration_tilt import explains_acceleration
from estimator.aiding.beginning import Start, begin, inflate_covariance, lag_variance
from estimator.aiding.consistency import NEW_CONSISTENCY, inflated
from estimator.aiding.phase import Cause
from estimator.aiding.push_and_field import PushAndField, misfits
from estimator.aiding.search import UNKNOWN_RAD, Search
from estimator.aiding.sources.velocity import is_credible
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.types import IMU_LAG, NO_REPORT, Report, Sigmas
from estimator.conditioning.field.magnetic import NORM_SCALE
from estimator.conditioning.params import LONG_S, REACH
from estimator.conditioning.rate import slow_share
from estimator.geometry.quaternion import (
    angle_between_vectors,
    conjugate,
    multiply,
    rotate,
)
from estimator.live import kernel_handle
from estimator.live.aided import is_worse
from estimator.live.core import Core, with_attitude
from estimator.live.settings import Settings
from estimator.live.starts import (
    find_start_by_both,
    find_start_by_field,
    find_start_by_velocity,
    iron_sigma_gauss,
    is_better,
    judge_field,
    see_push_and_field,
    start_level,
    unaided_sigma,
    verticals_apart,
)
from estimator.live.state import State
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3


def begin_aided(state: State, report: Report, *, has_heading: bool) -> None:
    """Velocity starts to help once there is a heading from true north.

    It comes from the field, or from the search where there is no usable field or no position that
    shows true from magnetic north. Behind a hole the search comes first: the unaided vertical may
    be off by any angle.
    """
    can_compare = has_heading and state.knows_north
    is_behind_hole = state.core.search.window.is_behind_hole
    start, follows_unaided = None, has_heading
    if is_behind_hole:
        start, follows_unaided = find_start_by_search(state, report, can_compare=can_compare)
    if start is None and can_compare:
        start, follows_unaided = find_start_by_field(state), True
    if start is None and not is_behind_hole:
        start, follows_unaided = find_start_by_search(state, report, can_compare=can_compare)
    if start is None:
        state.enter(Cause.REPORT)
        return
    # a field that is contradicted has shown no heading
    is_wrong = compass.is_contradicted(state.context.compass, state.time_us)
    follows_unaided = follows_unaided and has_heading and not is_wrong
    set_out(state, start, report, has_heading=follows_unaided)


def find_start_by_search(
    state: State, report: Report, *, can_compare: bool
) -> tuple[Start | None, bool]:
    """The attitude by velocity and field together, or by velocity alone, once a window shows it.

    The second value is whether the unaided attitude may be corrected to it, or is worth nothing.
    """
    if not state.run(kernel_handle.search, report):
        return None, True
    now = state.core
    start = find_start_by_both(state, now, see_push_and_field(state, now, report))
    if start is not None and is_better(start.sigma, unaided_sigma(state, now)):
        return start, False
    start = find_start_by_velocity(state, now, report)
    if start is not None and can_compare and not rolls(state.settings.aiding):
        start = judge_field(state, start)
    return start, True


def set_out(state: State, start: Start, report: Report, *, has_heading: bool) -> None:
    """Velocity helps from here on."""
    now = state.core
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


def reacquire(state: State, report: Report) -> bool:
    """Begin anew where velocity and field together contradict the aided attitude.

    This happens after a turn that the gyroscope has missed, and after a hole in the stream. Such an
    error is too large for small corrections, which have put it into the sensors' errors meanwhile:
    these are void, too. Returns whether it has begun anew.
    """
    now = state.core
    seen = see_push_and_field(state, now, report)
    start = find_start_by_both(state, now, seen)
    if seen is None or start is None or not is_contradicted(state, now, seen, start):
        return False
    # earlier windows belong to another G
    state.set_core(now._replace(search=Search(now.search.window), consistency=NEW_CONSISTENCY))
    set_out(state, start, report, has_heading=False)
    return True


def is_contradicted(state: State, now: Core, seen: PushAndField, start: Start) -> bool:
    """Whether the aided attitude is another one than velocity and field show together.

    Behind a hole that is so if the push misfits, or the field where the aided attitude is known
    worse. Else the push has to misfit by more than usual errors, with the accelerometer's largest
    bias, as a compass that is turned does not move it; what contradicts wheels may be the velocity.
    """
    q_ned_g = multiply(now.aided.estimate.q_ned_frd, conjugate(now.gathered.q_g_frd))
    if seen.push.is_behind_hole:
        by_push, by_field = misfits(seen, q_ned_g)
        is_known_better = is_better(start.sigma, inflated(now.aided.sigma, now.consistency))
        return by_push > REACH or (by_field > REACH and is_known_better)
    if rolls(state.settings.aiding):
        return False
    force = rotate(q_ned_g, seen.push.force_g_m_s)
    usual = REACH * NORM_SCALE + sqrt(now.aided.bias_prior.acc) / STANDARD_GRAVITY_M_S2
    return angle_between_vectors(force, seen.push.change_ned_m_s) > usual


def give_up(state: State) -> None:
    """Measurements contradict the aided attitude, or it is lost: go on with the better known one.

    A contradicted aided attitude goes on with an inflated covariance, unless the unaided one is
    better known then: the reports or the field may be wrong. Where only its vertical is lost, its
    heading goes on with the unaided vertical. Giving up an attitude that seemed the better one is
    evidence against the compass that it began with, unless reports have just been missing for long.
    Where wheels contradict the heading that it began with, velocity shows it anew.
    """
    core = state.core
    if core.aided.wheels.contradict:
        state.change_compass(misled_us=core.time_us)
        state.enter(Cause.MISLED)
        return
    other = unaided_sigma(state, core)
    aided, covariance = core.aided, core.covariance
    if not is_credible(aided):
        aided, covariance = inflate_covariance(aided, covariance)
    is_consistent = explains_acceleration(aided.acceleration_tilt) and isfinite(hypot(*aided.sigma))
    # with what the unaided down and the field show against it
    inclination_rad = hypot(aided.sigma.inclination_rad, verticals_apart(core))
    sigma = Sigmas(inclination_rad, inflated(aided.sigma, core.consistency).heading_rad)
    has_lost_down = is_worse(core.aided, core.seen) and not is_consistent
    if is_consistent or (is_better(sigma, other) and not has_lost_down):
        state.set_core(core._replace(aided=aided, covariance=covariance))
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


def with_imu_lag(core: Core, lag_s: float, lead_s: float) -> Core:
    """The core with other ages of the IMU's samples, as uncertain as at the beginning."""
    estimate = core.aided.estimate._replace(imu_lag_s=lag_s, acc_lead_s=lead_s)
    P = core.covariance.copy()
    P[IMU_LAG, :] = P[:, IMU_LAG] = 0.0
    P[IMU_LAG, IMU_LAG] = lag_variance(lag_s)
    return core._replace(aided=core.aided._replace(estimate=estimate), covariance=P)


def begin_aiding(
    settings: Settings, core: Core, start: Start, report: Report, iron_gauss: float
) -> Core:
    """The core with the aiding at its beginning, and the vehicle's own field as uncertain."""
    aiding = settings.aiding
    drift_rad_s = start.tilt_by_bias_rad / settings.conditioning.gravity_tau_s
    push_m_s2 = start.tilt_by_bias_rad * STANDARD_GRAVITY_M_S2
    aided, covariance, velocity_history = begin(
        aiding._replace(
            gyr_bias_sigma=max(aiding.gyr_bias_sigma, drift_rad_s),
            acc_bias_sigma=max(aiding.acc_bias_sigma, push_m_s2),
        ),
        start._replace(
            tilt_sigma_rad=start.tilt_sigma_rad or core.seen.sigma_inclination_rad,
            gyr_bias_rad_s=core.seen.bias_rad_s,
            hard_iron_sigma_gauss=iron_gauss,
            field_lag_s=settings.conditioning.field_lag_sigma_s,
        ),
        core.sample,
        report,
    )
    aided = aided._replace(wheels=core.aided.wheels)
    return core._replace(aided=aided, covariance=covariance, velocity_history=velocity_history)
