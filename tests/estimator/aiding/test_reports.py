"""Velocity reports that wait for the IMU."""

from math import inf, nan

import pytest

from estimator.aiding.sources.velocity import SPEED_LIMIT_M_S, refusal_of_velocity
from estimator.live.reports import MOST_WAITING, age_s, enqueue, report_with_age, take_due
from estimator.types import VelocitySample


def report(time_us, north=1.0):
    return VelocitySample(time_us, (north, 0.0, 0.0), True, 0.3)


def test_the_latest_that_the_imu_has_reached_counts_and_the_others_ahead_wait():
    waiting = (report(10, 1.0), report(30, 3.0), report(20, 2.0), report(50, 5.0))
    chosen, ahead = take_due(waiting, 40, 1.0)
    assert [report.velocity_ned_m_s[0] for report in chosen] == [3.0]
    assert age_s(chosen[0], 40) == report_with_age(chosen[0], 40).ago_s == pytest.approx(10e-6)
    assert ahead == (report(50, 5.0),)


def test_of_either_source_the_latest_counts():
    late = report(20, 2.0)._replace(late_sigma_s=0.1)
    chosen, ahead = take_due((report(10, 1.0), late, report(30, 3.0)), 40, 1.0)
    assert sorted(r.velocity_ned_m_s[0] for r in chosen) == [2.0, 3.0]
    assert ahead == ()


def test_an_old_report_is_none():
    chosen, ahead = take_due((report(0),), 600_000, 0.5)
    assert chosen == ()
    assert ahead == ()


def test_when_too_many_wait_the_oldest_gives_way():
    waiting = ()
    for time_us in range(MOST_WAITING + 3):
        waiting = enqueue(waiting, report(time_us))
    assert [r.time_us for r in waiting] == list(range(3, MOST_WAITING + 3))


@pytest.mark.parametrize(
    ("velocity", "sigma", "reason"),
    [
        ((nan, 0.0, 0.0), 0.3, "velocity_not_finite"),
        ((0.0, inf, 0.0), 0.3, "velocity_not_finite"),
        ((0.0, 0.0, 0.0), nan, "velocity_not_finite"),
        ((0.0, 0.0, SPEED_LIMIT_M_S + 1.0), 0.3, "velocity_out_of_range"),
        ((SPEED_LIMIT_M_S, 0.0, 0.0), 0.3, None),
    ],
)
def test_what_cannot_be_a_velocity_is_refused(velocity, sigma, reason):
    assert refusal_of_velocity(VelocitySample(0, velocity, True, sigma)) == reason
