"""The same estimator over the recording from its end to its beginning.

With time reversed, rates and velocities change their signs; forces, fields and attitudes do not.
Late sensors would be early, so their readings are first brought to their own times by the ages that
the way forward has learnt. Its bias is taken off, too.
"""

import numpy as np

from estimator.estimator import Estimator
from estimator.geometry.rotations import exp, multiply
from estimator.live.rows import (
    AIDED,
    IS_RATE,
    LATE_S,
    OUTPUT_SIZE,
    ROW,
    SIGMA,
    TIME,
    Q,
    Rows,
    X,
    Z,
    blocks,
    reports_between,
    rows_of,
)
from estimator.profile import merge_profile
from estimator.smoothing.field import usable_fields, without_lag
from estimator.smoothing.path import stands_for_step
from estimator.smoothing.recording import Estimates, Recording
from estimator.types import Floats, Times

# The least age that a profile allows (s): none.
NO_AGE_S = 1e-4
FIRST_US = 1_000_000


def backward(recording: Recording) -> Estimates:
    """The estimates at the samples by all that came behind them."""
    n = len(recording.bias_rad_s)
    recording = recording._replace(rows=recording.rows._replace(has_mag=usable_fields(recording)))
    ages = Ages(recording.last)
    inner = of_reversed_time(recording.last)
    mirrored_us = int(recording.rows.times_us[-1]) + FIRST_US
    times_us = np.asarray((mirrored_us - recording.rows.times_us)[::-1])  # in time turned round
    q, sigma, aided = np.full((n, 4), np.nan), np.full((n, 2), np.nan), np.zeros(n, np.bool_)
    reports = turned_round(
        recording.reports, times_us, mirrored_us, ages.of(recording.reports[:, LATE_S]), NO_AGE_S
    )
    changes = {n - row for row in recording.changes}
    begin = 0
    for end in sorted(changes | {part.stop for part in blocks(n)}):
        mirrored = mirror(recording, times_us, begin, end, ages.field_s)
        output = np.empty((end - begin, OUTPUT_SIZE))
        inner.take_all(mirrored, output, reports_between(reports, begin, end))
        q[begin:end], sigma[begin:end] = output[:, Q], output[:, SIGMA]
        aided[begin:end] = output[:, AIDED] > 0.0
        if end in changes:
            inner.change_imu()
        begin = end
    back = Estimates(q[::-1], sigma[::-1], aided[::-1])
    for part in blocks(n):
        rate = recording.rows.gyr_rad_s[part] - recording.bias_rad_s[part]
        ahead = exp(np.where(back.is_aided[part, None], ages.imu_s, 0.0) * rate)
        back.q_ned_frd[part] = multiply(back.q_ned_frd[part], ahead)
    return back


class Ages:
    """How late the sensors are (s), as the aiding has learnt it; 0 without one."""

    def __init__(self, last: Estimator) -> None:
        core, is_aided = last.core, last.is_aided
        estimate = core.aided.estimate
        self.imu_s = estimate.imu_lag_s if is_aided else last.settings.aiding.imu_lag_s
        self.filter_s = estimate.filter_lag_s if is_aided else 0.0
        self.receiver_s = estimate.receiver_lag_s if is_aided else 0.0
        self.field_s = core.conditioning.field.calibration.learnt.lag_s

    def of(self, late_s: Floats) -> Floats:
        """How far behind the IMU's samples a report's time is its own (M,)."""
        by_receiver = self.receiver_s or late_s
        return np.asarray(np.where(late_s > 0.0, by_receiver, self.filter_s) - self.imu_s)


def of_reversed_time(last: Estimator) -> Estimator:
    """An estimator that knows place and vehicle as the last one does, and of no age."""
    changes = {"aiding": {"imu_lag_s": NO_AGE_S}}
    inner = Estimator(merge_profile(last.profile, changes), last.fixed_gain)
    inner.snapshot = inner.snapshot._replace(context=last.snapshot.context)
    inner.restart()
    inner.set_imu_lag(0.0, 0.0)
    return inner


def mirror(recording: Recording, times_us: Times, begin: int, end: int, field_lag_s: float) -> Rows:
    """Rows in time turned round, from ``begin`` up to ``end`` of their ``times_us`` (N,).

    A sample that stands for the step before it stands for the one behind it then.
    """
    rows = recording.rows
    n = len(times_us)
    behind = np.arange(n - begin, n - end, -1) - 1
    behind = np.minimum(behind + stands_for_step(recording)[behind], n - 1)
    rate = rows.gyr_rad_s[behind] - recording.bias_rad_s[recording.last_rows(behind)]
    field = without_lag(rows.mag_gauss[behind], rate, field_lag_s)
    return rows_of(times_us[begin:end], -rate, rows.acc_m_s2[behind], field, rows.has_mag[behind])


def turned_round(
    reports: Floats, times_us: Times, mirrored_us: int, velocity_age_s: Floats, late_s: float
) -> Floats:
    """Velocities and rates (M, REPORT_SIZE) before the samples of ``times_us``, both turned round.

    Times are those to ``mirrored_us``. A velocity is brought to its own time by its age (M,), and
    is late by no more than ``late_s``.
    """
    is_rate, turned = reports[:, IS_RATE] > 0.0, reports.copy()
    age_us = np.where(is_rate, 0.0, np.rint(1e6 * velocity_age_s))
    turned[:, TIME] = mirrored_us - reports[:, TIME] + age_us
    turned[:, X : Z + 1] = -reports[:, X : Z + 1]
    turned[:, LATE_S] = np.minimum(reports[:, LATE_S], late_s)
    turned[:, ROW] = np.searchsorted(times_us, turned[:, TIME])
    return np.asarray(turned[np.lexsort((~is_rate, turned[:, TIME]))])
