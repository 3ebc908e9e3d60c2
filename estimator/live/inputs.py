"""What others than the IMU report: velocity, rates, the place."""

from typing import Any

from estimator.aiding import compass
from estimator.aiding.phase import Cause, Phase
from estimator.aiding.place import differ, update_whereabouts
from estimator.aiding.sources.source import in_types_of
from estimator.aiding.sources.table import source_of
from estimator.aiding.sources.wheels import rolls
from estimator.aiding.velocity_history import OLDEST_S
from estimator.geometry.quaternion import exp, multiply
from estimator.live.compass_check import check_compass
from estimator.live.core import with_attitude
from estimator.live.refusal import RATE_LIMIT_RAD_S
from estimator.live.reports import MOST_WAITING, age_s
from estimator.live.rows import report_rows_of
from estimator.live.state import State
from estimator.reasons import Reason
from estimator.types import RateSample, VelocitySample


def take_report(state: State, report: Any) -> Reason | None:
    """Take a report of a source of aiding; None, or why it was refused.

    Raises:
        InputError: no source makes such reports, or a field is no number.
    """
    source = source_of(report)
    report = in_types_of(source.blank, report)
    reason = source.refusal(report)
    if reason is not None or not state.settings.conditioned:
        return reason
    core = state.ready()
    if isinstance(report, VelocitySample):
        if core.take_report(report_rows_of([(0, report)])[0]):
            check_compass(state, core.last_report[0])
    elif state.context.phase is Phase.AIDED:
        if report.time_us > core.time_us:
            waiting = (*state.context.reports, report)
            state.change_context(reports=waiting[-MOST_WAITING:])
        elif age_s(report, core.time_us) <= OLDEST_S:
            core.take_other_report(report, core.time_us)
    return None


def take_rate(state: State, rate: RateSample) -> Reason | None:
    """Take body rates of another messenger; None, or why they were refused."""
    x, y, z = rate.rate_rad_s
    if not (
        abs(x) <= RATE_LIMIT_RAD_S and abs(y) <= RATE_LIMIT_RAD_S and abs(z) <= RATE_LIMIT_RAD_S
    ):
        return Reason.GYROSCOPE_OUT_OF_RANGE  # or no number
    if not state.profile.uses_attitude_rates:
        return None
    state.core.take_rate(rate.time_us, float(x), float(y), float(z))
    return None


def set_position(
    state: State, latitude_deg: float, longitude_deg: float, altitude_m: float, unix_us: int
) -> bool:
    """See :meth:`estimator.estimator.Estimator.set_position`."""
    if not state.settings.learns_north:
        return False
    before = state.context.whereabouts
    known = update_whereabouts(before, latitude_deg, longitude_deg, altitude_m, unix_us)
    if known is before:
        return False
    declination_rad = state.declination_rad or 0.0
    state.change_context(whereabouts=known)
    if known.here is None or known.here is before.here:
        return True
    state.replace_profile(state.profile)
    now, field = state.core.core, known.here.field
    is_aided = state.context.phase is Phase.AIDED
    if not is_aided or (now.seen.has_heading and not rolls(state.settings.aiding)):
        # magnetic until now, or by another place's declination; by velocity it is true already
        turn = exp((0.0, 0.0, field.declination_rad - declination_rad))
        state.set_core(with_attitude(now, multiply(turn, now.filter.q_ned_frd)))
    if before.here is not None and differ(before.here.field, field):
        # verdicts on the compass, and the aiding, were drawn from another place's field
        state.enter(Cause.MISLED)
        if state.context.compass.turned_rad != 0.0:
            state.turn_compass(-state.context.compass.turned_rad)
        state.change_context(compass=compass.restart(state.context.compass))
    return True
