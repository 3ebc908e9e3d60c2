"""The same estimator over the recording from its end to its beginning.

With time turned round, rates and velocities change their signs; forces, fields and attitudes do
not. Sensors that are late would be early, so their readings are first brought to their own times,
by the ages that the way forward has taught. Its bias is taken off, too.
"""

from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from estimator.estimator import Estimator
from estimator.live.rows import SAID, Rows, cut, rows_of
from estimator.profile import merge_profile
from estimator.smoothing.field import without_lag
from estimator.smoothing.path import stands_for_step
from estimator.smoothing.recording import BLOCK, SIGMA, Estimates, Q, Recording, blocks
from estimator.smoothing.rotation import exp, multiply
from estimator.types import RateSample, VelocitySample

# The least age that a profile allows (s): none.
NO_AGE_S = 1e-4


def backward(recording: Recording) -> Estimates:
    """The estimates at the samples by all that came behind them."""
    rows = recording.rows
    n = len(rows.times_us)
    ages = Ages(recording.last)
    inner = turned_round(recording.last)
    end_us = int(rows.times_us[-1])
    mirrored = mirror(recording, ages.field_s)
    q, sigma, aided = np.full((n, 4), np.nan), np.full((n, 2), np.nan), np.zeros(n, np.bool_)
    begin = 0
    told: list[tuple[int, Any]] = [(n - row, None) for row in recording.changes]
    told.extend(
        (int(np.searchsorted(mirrored.times_us, report.time_us)), report)
        for report in mirrored_reports(recording.reports, end_us, ages)
    )
    for until, report in (*sorted(told, key=itemgetter(0)), (n, None)):
        while begin < until:
            end = min(begin + BLOCK, until)
            said = np.full((end - begin, SAID), np.nan)
            take(inner, cut(mirrored, begin, end), said, aided[begin:end])
            q[begin:end], sigma[begin:end] = said[:, Q], said[:, SIGMA]
            begin = end
        if report is not None:
            inner.update_report(report)
        elif until < n:
            inner.change_imu()
    back = Estimates(q[::-1], sigma[::-1], aided[::-1])
    for part in blocks(n):
        rate = recording.rows.gyr_rad_s[part] - recording.bias_rad_s[part]
        ahead = exp(np.where(back.is_aided[part, None], ages.imu_s, 0.0) * rate)
        back.q_ned_frd[part] = multiply(back.q_ned_frd[part], ahead)
    return back


class Ages:
    """How late the sensors are (s), as the aiding has learnt it; 0 without one."""

    def __init__(self, last: Estimator) -> None:
        estimate, is_aided = last.snapshot.core.aided.estimate, last.is_aided
        self.imu_s = estimate.imu_lag_s if is_aided else last.settings.aiding.imu_lag_s
        self.filter_s = estimate.filter_lag_s if is_aided else 0.0
        receiver_s = estimate.receiver_lag_s if is_aided else last.settings.aiding.receiver_lag_s
        self.receiver_s = receiver_s
        self.field_s = last.snapshot.core.conditioning.field.calibration.learnt.lag_s

    def of(self, report: VelocitySample | RateSample) -> float:
        """How far behind the IMU's samples a report's time is its own."""
        if isinstance(report, RateSample):
            return 0.0
        own_s = self.receiver_s if report.late_sigma_s > 0.0 else self.filter_s
        return float(own_s - self.imu_s)


def turned_round(last: Estimator) -> Estimator:
    """An estimator that knows place and vehicle as the last one does, and of no age."""
    changes = {"aiding": {"imu_lag_s": NO_AGE_S, "receiver_lag_s": NO_AGE_S}}
    inner = Estimator(merge_profile(last.profile, changes), last.fixed_gain)
    inner.snapshot = inner.snapshot._replace(context=last.snapshot.context)
    inner.restart()
    inner.set_imu_lag(0.0, 0.0)
    return inner


def mirror(recording: Recording, field_lag_s: float) -> Rows:
    """The rows in time turned round, which begins at 1 s.

    A sample that stands for the step before it stands for the one behind it then.
    """
    rows, is_mean = recording.rows, stands_for_step(recording)
    rate = rows.gyr_rad_s - recording.bias_rad_s[recording.last_rows()]
    field = without_lag(rows.mag_gauss, rate, field_lag_s)
    n = len(rate)
    behind = np.where(is_mean, np.minimum(np.arange(n) + 1, n - 1), np.arange(n))[::-1]
    times_us = (rows.times_us[-1] - rows.times_us + 1_000_000)[::-1]
    return rows_of(
        times_us, -rate[behind], rows.acc_m_s2[behind], field[behind], rows.has_mag[behind]
    )


def mirrored_reports(
    reports: Sequence[VelocitySample | RateSample], end_us: int, ages: Ages
) -> list[Any]:
    """The reports in time turned round, in that order."""

    def turned() -> Iterator[Any]:
        for report in reports:
            time_us = end_us - (report.time_us - round(1e6 * ages.of(report))) + 1_000_000
            if isinstance(report, RateSample):
                x, y, z = report.rate_rad_s
                yield RateSample(time_us, (-x, -y, -z))
            else:
                x, y, z = report.velocity_ned_m_s
                yield report._replace(time_us=time_us, velocity_ned_m_s=(-x, -y, -z))

    return sorted(turned(), key=lambda report: report.time_us)


def take(inner: Estimator, rows: Rows, said: Any, aided: Any) -> None:
    """All rows, many at a time where nothing else is to be done."""
    begin, end = 0, len(said)
    while begin < end:
        begin += inner.update_rows(cut(rows, begin, end), said[begin:end])
        if begin < end:
            time_us, gyr, acc, mag = (column[begin].tolist() for column in rows[:4])
            inner.take(time_us, tuple(gyr), tuple(acc), tuple(mag), bool(rows.has_mag[begin]))
            if inner.aligned:
                attitude = inner.attitude(time_us)
                said[begin, :4] = attitude.q_ned_frd
                said[begin, 15:17] = attitude.sigma_inclination_rad, attitude.sigma_heading_rad
                aided[begin] = inner.is_aided
            begin += 1
