"""Reports of aiding sources that wait for the IMU sample behind them.

Velocities wait in compiled memory, as rows of :mod:`estimator.live.rows`; others as they are.
"""

from typing import Any

import numpy as np

from estimator.aiding.types import NO_REPORT, Report
from estimator.arrays import Floats
from estimator.compilation.compiled import inlined
from estimator.live.rows import HAS_VERTICAL, LATE_S, SIGMA_M_S, TIME, X, Y, Z

# Reports come about as often as IMU samples do; of more than this the oldest go.
MOST_WAITING = 8


@inlined
def enqueue(waiting: Floats, row: Floats, most: int) -> Floats:
    """The waiting rows with a new one; of more than ``most`` the oldest goes."""
    kept = waiting[max(0, len(waiting) + 1 - most) :]
    longer = np.empty((len(kept) + 1, len(row)))
    longer[:-1] = kept
    longer[-1] = row
    return longer


@inlined
def take_due_velocities(
    waiting: Floats, time_us: int, oldest_s: float
) -> tuple[Floats, Report, Report]:
    """Those ahead of the IMU, and the latest of each source that it has reached by ``time_us``.

    A report waits for the first IMU sample that is not before it. Only the latest counts, as errors
    stay the same for a second or more. The two sources are a receiver, whose age is uncertain, and
    a filter; the one that began to wait first comes first.
    """
    earliest, latest = np.full(2, -1), np.full(2, -1)  # rows, of filter and receiver
    for k in range(len(waiting)):
        at = waiting[k, TIME]
        if at <= time_us:
            source = 1 if waiting[k, LATE_S] > 0.0 else 0
            if earliest[source] < 0 or at < waiting[earliest[source], TIME]:
                earliest[source] = k
            if latest[source] < 0 or at >= waiting[latest[source], TIME]:
                latest[source] = k
    one, other = NO_REPORT, NO_REPORT
    if latest[0] >= 0:
        one = velocity_at(waiting[latest[0]], time_us, oldest_s)
    if latest[1] >= 0:
        other = velocity_at(waiting[latest[1]], time_us, oldest_s)
    a, b = earliest
    is_second = waiting[b, TIME] < waiting[a, TIME] or (
        waiting[b, TIME] == waiting[a, TIME] and b < a
    )
    if not one.given or (other.given and is_second):
        one, other = other, one
    return waiting[waiting[:, TIME] > time_us], one, other


@inlined
def velocity_at(row: Floats, time_us: int, oldest_s: float) -> Report:
    """A row as it is seen from the IMU sample of ``time_us``, if it is no older."""
    ago_s = 1e-6 * (time_us - int(row[TIME]))
    if ago_s > oldest_s:
        return NO_REPORT
    velocity = (row[X], row[Y], row[Z])
    return Report(True, velocity, row[HAS_VERTICAL] > 0.0, row[SIGMA_M_S], ago_s, row[LATE_S])


def take_due(
    waiting: tuple[Any, ...], time_us: int, oldest_s: float
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The latest of each type that the IMU has reached, and those ahead of it."""
    ahead = tuple(report for report in waiting if report.time_us > time_us)
    reached = sorted((r for r in waiting if r not in ahead), key=lambda report: report.time_us)
    latest = {type(report): report for report in reached}
    return tuple(r for r in latest.values() if age_s(r, time_us) <= oldest_s), ahead


def age_s(report: Any, time_us: int) -> float:
    """How long before ``time_us`` it was measured."""
    return 1e-6 * (time_us - int(report.time_us))
