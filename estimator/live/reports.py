"""Velocity reports that wait for the IMU sample behind them."""

from math import isfinite

from estimator.aiding.types import Report
from estimator.reasons import Reason
from estimator.types import VelocitySample

Reports = tuple[VelocitySample, ...]

# Reports come about as often as IMU samples do; of more than this the oldest are dropped.
MOST_WAITING = 8
# Faster than sound in air: no vehicle this is for.
SPEED_LIMIT_M_S = 400.0


def refusal_of_report(report: VelocitySample) -> Reason | None:
    """Why a report cannot be used, None if it can."""
    if not all(isfinite(v) for v in (*report.velocity_ned_m_s, report.sigma_m_s)):
        return Reason.VELOCITY_NOT_FINITE
    if max(abs(v) for v in report.velocity_ned_m_s) > SPEED_LIMIT_M_S:
        return Reason.VELOCITY_OUT_OF_RANGE
    return None


def enqueue(waiting: Reports, report: VelocitySample) -> Reports:
    """The waiting reports with a new one; the oldest gives way when there are too many."""
    return (*waiting, report)[-MOST_WAITING:]


def take_due(waiting: Reports, time_us: int, oldest_s: float) -> tuple[tuple[Report, ...], Reports]:
    """The latest of either source that the IMU has reached by ``time_us``, and those ahead of it.

    A report waits for the first IMU sample that is not before it. Only the
    latest of several counts: their errors are the same for a second or more.
    """
    reached = [report for report in waiting if report.time_us <= time_us]
    ahead = tuple(report for report in waiting if report.time_us > time_us)
    latest = {r.late_sigma_s > 0.0: r for r in sorted(reached, key=lambda r: r.time_us)}
    due = (report_with_age(report, time_us) for report in latest.values())
    return tuple(report for report in due if report.ago_s <= oldest_s), ahead


def report_with_age(report: VelocitySample, time_us: int) -> Report:
    """A report as it is seen from the IMU sample of ``time_us``."""
    return Report(
        given=True,
        velocity_ned_m_s=report.velocity_ned_m_s,
        has_vertical=report.has_vertical,
        sigma_m_s=report.sigma_m_s,
        ago_s=1e-6 * (time_us - report.time_us),
        late_sigma_s=report.late_sigma_s,
    )
