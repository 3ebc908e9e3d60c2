"""What others than the IMU measure, into the state."""

from typing import Any

from estimator.aiding.phase import Phase
from estimator.aiding.sources.source import in_types_of
from estimator.aiding.sources.table import source_of
from estimator.aiding.velocity_history import OLDEST_S
from estimator.live.compass_check import check_compass
from estimator.live.refusal import RATE_LIMIT_RAD_S
from estimator.live.reports import MOST_WAITING, age_s
from estimator.live.rows import told_of
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
        if core.hear(told_of([(0, report)])[0]):
            check_compass(state, core.last_report[0])
    elif state.context.phase is Phase.AIDED:
        if report.time_us > core.time_us:
            waiting = (*state.context.reports, report)
            state.change_context(reports=waiting[-MOST_WAITING:])
        elif age_s(report, core.time_us) <= OLDEST_S:
            core.hear_other(report, core.time_us)
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
    state.core.hear_rate(rate.time_us, float(x), float(y), float(z))
    return None
