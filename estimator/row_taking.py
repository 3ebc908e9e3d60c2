"""Many samples through one estimator, with its output after each of them."""

from math import nan

import numpy as np

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.live.rows import NO_REPORT_ROWS, NORTH, NORTHS, ROW, Q, Rows, report_of
from estimator.reasons import Reason


def take(
    inner: Estimator, rows: Rows, published: Floats, report_rows: Floats = NO_REPORT_ROWS
) -> list[Reason]:
    """Take all rows and the reports before them, many at a time where possible.

    ``published`` (N, OUTPUT_SIZE) gets the attitude after each row, NaN where there is none. An
    estimator whose attitude is not finite begins anew. Returns why something was refused.
    """
    refused: list[Reason | None] = []
    taken, next_report, n = 0, 0, len(published)
    while taken < n:
        begin = taken
        taken, next_report = inner.update_rows(rows, published, report_rows, taken, next_report)
        if taken > begin and not np.isfinite(published[taken - 1, Q]).all():
            refused.append(begin_anew(inner, published[taken - 1]))
        if taken < n:
            while next_report < len(report_rows) and report_rows[next_report, ROW] <= taken:
                refused.append(inner.update_report(report_of(report_rows[next_report])))
                next_report += 1
            time_us, gyr, acc, mag, has_mag = (column[taken].tolist() for column in rows)
            field = tuple(mag) if has_mag else (0.0, 0.0, 0.0)
            refused.append(inner.take(time_us, tuple(gyr), tuple(acc), field, has_mag))
            refused.append(put(inner, time_us, published[taken]))
            taken += 1
    return [reason for reason in refused if reason is not None]


def put(inner: Estimator, time_us: int, row: Floats) -> Reason | None:
    """The attitude into a row, NaN if there is none; the reason if it has been lost."""
    row[:], row[NORTH] = nan, 0.0
    if not inner.aligned:
        return None
    one = inner.attitude(time_us)
    place = NORTHS.index(one.heading_reference)
    row[:] = (*one[1], *one[2], *one[3], *one[4:11], place, inner.is_aided)
    return None if np.isfinite(row[Q]).all() else begin_anew(inner, row)


def begin_anew(inner: Estimator, row: Floats) -> Reason:
    """Restart after an attitude that is not finite: no later sample would repair it."""
    row[:], row[NORTH] = nan, 0.0
    inner.restart()
    return Reason.ESTIMATE_NOT_FINITE
