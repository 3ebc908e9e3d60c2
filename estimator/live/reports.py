"""Reports of aiding sources that wait for the IMU sample behind them."""

from typing import Any

from estimator.aiding.types import Report
from estimator.types import VelocitySample

# Reports come about as often as IMU samples do; of more than this of one type the oldest go.
MOST_WAITING = 8


def enqueue(waiting: tuple[Any, ...], report: Any) -> tuple[Any, ...]:
    """The waiting reports with a new one; the oldest of its type gives way to one too many."""
    alike = [k for k, other in enumerate(waiting) if type(other) is type(report)]
    if len(alike) >= MOST_WAITING:
        waiting = (*waiting[: alike[0]], *waiting[alike[0] + 1 :])
    return (*waiting, report)


def take_due(
    waiting: tuple[Any, ...], time_us: int, oldest_s: float
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The latest of each source that the IMU has reached by ``time_us``, and those ahead of it.

    A report waits for the first IMU sample that is not before it. Only the
    latest of several counts: their errors are the same for a second or more.
    """
    reached = [report for report in waiting if report.time_us <= time_us]
    ahead = tuple(report for report in waiting if report.time_us > time_us)
    latest = {_origin(report): report for report in sorted(reached, key=lambda r: r.time_us)}
    return tuple(r for r in latest.values() if age_s(r, time_us) <= oldest_s), ahead


def _origin(report: Any) -> tuple[type, bool]:
    """Velocity comes from two sources: a receiver, whose age is uncertain, and a filter."""
    return type(report), isinstance(report, VelocitySample) and report.late_sigma_s > 0.0


def age_s(report: Any, time_us: int) -> float:
    """How long before ``time_us`` it was measured."""
    return 1e-6 * (time_us - int(report.time_us))


def report_with_age(report: VelocitySample, time_us: int) -> Report:
    """A velocity report as it is seen from the IMU sample of ``time_us``."""
    return Report(
        given=True,
        velocity_ned_m_s=report.velocity_ned_m_s,
        has_vertical=report.has_vertical,
        sigma_m_s=report.sigma_m_s,
        ago_s=age_s(report, time_us),
        late_sigma_s=report.late_sigma_s,
    )
