"""What was reported, told once more in time turned round."""

import numpy as np

from estimator.live.rows import ROW, report_of, report_rows_of
from estimator.smoothing.backward import turned_round
from estimator.types import RateSample, VelocitySample

MIRRORED_US = 10_000_000


def velocity(time_us: int, north_m_s: float) -> VelocitySample:
    return VelocitySample(time_us, (north_m_s, 0.0, -1.0), True, 0.1, late_sigma_s=0.05)


def test_time_turned_round_changes_signs_and_order_and_takes_ages_off():
    velocities = [velocity(1_000_000, 3.0), velocity(2_000_000, 4.0)]
    rates = [RateSample(1_000_000 * k, (0.1 * k, 0.0, -0.2)) for k in (1, 2, 3)]
    told = report_rows_of((0, report) for report in (*velocities, *rates))
    times_us = np.array([6_000_000, 8_100_000])
    rows = turned_round(told, times_us, MIRRORED_US, np.full(len(told), 0.25), late_s=1e-4)
    back = [report_of(row) for row in rows]
    assert rows[:, ROW].tolist() == [1, 1, 2, 2, 2]
    assert [report.time_us for report in back] == [
        *(7_000_000, 8_000_000, 8_250_000, 9_000_000, 9_250_000)
    ]
    assert [report for report in back if isinstance(report, RateSample)] == [
        RateSample(MIRRORED_US - r.time_us, (-r.rate_rad_s[0], -0.0, 0.2)) for r in reversed(rates)
    ]
    assert back[-1] == velocities[0]._replace(
        time_us=9_250_000, velocity_ned_m_s=(-3.0, 0.0, 1.0), late_sigma_s=1e-4
    )
