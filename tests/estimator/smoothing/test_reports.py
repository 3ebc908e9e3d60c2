"""What was reported, told once more in time turned round."""

import tracemalloc

from estimator.smoothing.reports import Reports
from estimator.types import RateSample, VelocitySample

MIRRORED_US = 10_000_000


def velocity(time_us: int, north_m_s: float) -> VelocitySample:
    return VelocitySample(time_us, (north_m_s, 0.0, -1.0), True, 0.1, late_sigma_s=0.05)


def test_time_turned_round_changes_signs_and_order_and_takes_ages_off():
    reports = Reports()
    assert not reports
    told = [velocity(1_000_000, 3.0), velocity(2_000_000, 4.0)]
    rates = [RateSample(1_000_000 * k, (0.1 * k, 0.0, -0.2)) for k in (1, 2, 3)]
    for report in (*told, *rates):
        reports.add(report)
    assert reports
    back = list(reports.turned_round(MIRRORED_US, lambda _: 0.25, late_s=1e-4))
    times_us = [7_000_000, 8_000_000, 8_250_000, 9_000_000, 9_250_000]
    assert [report.time_us for report in back] == times_us
    assert [report for report in back if isinstance(report, RateSample)] == [
        RateSample(MIRRORED_US - r.time_us, (-r.rate_rad_s[0], -0.0, 0.2)) for r in reversed(rates)
    ]
    last = back[-1]
    assert isinstance(last, VelocitySample)
    assert last == told[0]._replace(
        time_us=9_250_000, velocity_ned_m_s=(-3.0, 0.0, 1.0), late_sigma_s=1e-4
    )


def test_a_rate_takes_its_32_bytes():
    count = 100_000
    tracemalloc.start()
    try:
        reports = Reports()
        for k in range(count):
            reports.add(RateSample(2500 * k, (0.1, 0.2, 0.3)))
        kept, _ = tracemalloc.get_traced_memory()
        for _ in reports.turned_round(2500 * count, lambda _: 0.0, late_s=0.0):
            pass
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept / count < 32 * 1.25  # measured 34: arrays grow by an eighth
    assert most / count < 32 * 1.25 + 24  # times and order in time turned round
