"""What others than the IMU measure, into the state."""

from typing import Any

from estimator.aiding.phase import Phase
from estimator.aiding.sources.source import in_types_of
from estimator.aiding.sources.table import source_of
from estimator.aiding.velocity_history import OLDEST_S
from estimator.live.compass_check import check_compass
from estimator.live.refusal import RATE_LIMIT_RAD_S
from estimator.live.reports import age_s, enqueue, report_with_age
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
    is_aided, time_us = state.context.phase is Phase.AIDED, state.core.time_us
    if is_aided and report.time_us <= time_us:
        # it belongs to the last sample or to one just before it
        if age_s(report, time_us) <= OLDEST_S and state.core.hear(report, time_us):
            check_compass(state, report_with_age(report, time_us))
    elif is_aided or isinstance(report, VelocitySample):
        state.change_context(reports=enqueue(state.context.reports, report))
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
    is_kept = state.core.hear_rate(rate.time_us, float(x), float(y), float(z))
    if is_kept and not state.context.has_rates:
        state.change_context(has_rates=True)
    return None
