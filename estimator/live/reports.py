"""Velocity reports that wait for the IMU sample behind them."""

from math import isfinite

from estimator.aiding.types import NO_REPORT, Report
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


def take_due(waiting: Reports, time_us: int, oldest_s: float) -> tuple[Report, Reports]:
    """The latest report that the IMU has reached by ``time_us``, and those still ahead of it.

    A report waits for the first IMU sample that is not before it. Only the
    latest of several counts: their errors are the same for a second or more.
    """
    reached = [report for report in waiting if report.time_us <= time_us]
    ahead = tuple(report for report in waiting if report.time_us > time_us)
    if not reached:
        return NO_REPORT, ahead
    latest = max(reached, key=lambda report: report.time_us)
    ago_s = 1e-6 * (time_us - latest.time_us)
    if ago_s > oldest_s:
        return NO_REPORT, ahead
    report = Report(
        given=True,
        velocity_ned_m_s=latest.velocity_ned_m_s,
        has_vertical=latest.has_vertical,
        sigma_m_s=latest.sigma_m_s,
        ago_s=ago_s,
        late_sigma_s=latest.late_sigma_s,
    )
    return report, ahead
