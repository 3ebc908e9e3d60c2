"""Velocity reports that wait for the IMU: which are due, what they are worth and refer to."""

from math import cos, inf, nan, sin

import numpy as np
import pytest

from estimator.aiding.sources.source import SPEED_LIMIT_M_S, refusal_of_velocity
from estimator.aiding.sources.velocity import wait_for_reports
from estimator.aiding.types import Agreement, Agreements, AidingParams, Scatter
from estimator.aiding.velocity_history import (
    ROWS,
    extend_velocity_history,
    look_back,
    new_velocity_history,
)
from estimator.estimator import Estimator
from estimator.live.rows import MOST_WAITING, TIME, enqueue, report_rows_of, take_due_velocities
from estimator.types import VelocitySample
from tests.flight import banked_flight, north_known, taken_along

SAMPLES = 480  # 9.6 s at 50 Hz: in the first banked turn


@pytest.fixture(scope="module")
def flying():
    """A flight, and the state in its turn."""
    flight = banked_flight(seconds=10.0)
    estimator = taken_along(north_known(), flight, SAMPLES)
    return flight, estimator.profile, estimator.snapshot


def numbers(snapshot):
    """Every estimate of the aiding and the velocities reported, one after the other."""
    aided = snapshot.core.aided
    reported = aided.acceleration_tilt.reported_m_s, aided.acceleration_tilt.latest_m_s
    parts = [np.atleast_1d(np.asarray(part)) for part in (*aided.estimate, *reported)]
    return np.concatenate(parts)


def learnt_from(flying, **changes):
    """The numbers after one more sample and a report."""
    flight, profile, state = flying
    time_us = flight.samples[SAMPLES].time_us
    report = VelocitySample(time_us, (3.0, 19.0, 0.3), True, 0.3)._replace(**changes)
    estimator = Estimator(profile)
    estimator.snapshot = state
    estimator.update_report(report)
    estimator.update(flight.samples[SAMPLES])
    return numbers(estimator.snapshot)


@pytest.mark.parametrize("late_sigma_s", [0.0, 0.1])
def test_before_or_behind_its_sample(flying, late_sigma_s):
    flight, profile, state = flying
    sample = flight.samples[SAMPLES]._replace(has_mag=False, mag_gauss=(0.0, 0.0, 0.0))
    report = VelocitySample(sample.time_us, (3.0, 19.0, 0.3), True, 0.3, late_sigma_s)
    after = {}
    for when in ("never", "before", "behind"):
        estimator = Estimator(profile)
        estimator.snapshot = state
        if when == "before":
            estimator.update_report(report)
        estimator.update(sample)
        if when == "behind":
            estimator.update_report(report)
        after[when] = numbers(estimator.snapshot)
    learnt = after["before"] - after["never"]
    assert np.abs(learnt).max() == pytest.approx(18.0, rel=0.2)  # m/s; measured 18.3 and 17.4
    np.testing.assert_allclose(after["behind"], after["before"], rtol=1e-12, atol=1e-15)


def test_a_report_that_claims_to_be_better_than_a_receiver_can_be_is_worth_no_more(flying):
    least = AidingParams().report_sigma_m_s
    usual = learnt_from(flying, sigma_m_s=least)
    assert np.array_equal(learnt_from(flying, sigma_m_s=0.1 * least), usual)
    assert not np.allclose(learnt_from(flying, sigma_m_s=3.0 * least), usual)


def test_a_report_without_its_vertical_teaches_nothing_by_it(flying):
    one, other = (
        learnt_from(flying, velocity_ned_m_s=(3.0, 19.0, down), has_vertical=False)[:-6]
        for down in (0.3, 9.0)
    )
    assert np.array_equal(one, other)
    assert not np.allclose(one, learnt_from(flying)[:-6])


def report(time_us, north=1.0, late_s=0.0):
    return VelocitySample(time_us, (north, 0.0, 0.0), True, 0.3, late_s)


def due(*waiting):
    """What is due at 40 us if it is 30 us old at most, and the times of what is ahead then."""
    rows = report_rows_of((0, each) for each in waiting)
    ahead, *reports = take_due_velocities(rows, 40, 30e-6)
    return [each for each in reports if each.given], ahead[:, TIME].tolist()


OTHER = report(20, 2.0, late_s=0.1)  # of the other source


@pytest.mark.parametrize(
    ("waiting", "north_m_s", "ahead_us"),
    [
        # the latest that the IMU has reached; those ahead wait
        ([report(10, 1.0), report(30, 3.0), report(20, 2.0), report(50, 5.0)], [3.0], [50]),
        # of either source; the one whose reports have waited longest comes first
        ([report(10, 1.0), OTHER, report(30, 3.0)], [3.0, 2.0], []),
        ([report(25, 1.0), OTHER, report(30, 3.0)], [2.0, 3.0], []),
        ([report(0)], [], []),  # too old
    ],
)
def test_the_latest_of_each_source_counts(waiting, north_m_s, ahead_us):
    chosen, ahead = due(*waiting)
    assert [each.velocity_ned_m_s for each in chosen] == [(x, 0.0, 0.0) for x in north_m_s]
    assert [each.ago_s for each in chosen if each.velocity_ned_m_s[0] == 3.0] == pytest.approx(
        [10e-6] * (3.0 in north_m_s)
    )
    assert ahead == ahead_us


def test_when_too_many_wait_the_oldest_gives_way():
    waiting = report_rows_of(())
    for time_us in range(MOST_WAITING + 3):
        waiting = enqueue(waiting, report_rows_of([(0, report(time_us))])[0], MOST_WAITING)
    assert waiting[:, TIME].tolist() == list(range(3, MOST_WAITING + 3))


@pytest.mark.parametrize(
    ("velocity", "sigma", "reason"),
    [
        ((nan, 0.0, 0.0), 0.3, "velocity_not_finite"),
        ((0.0, inf, 0.0), 0.3, "velocity_not_finite"),
        ((0.0, 0.0, 0.0), nan, "velocity_not_finite"),
        ((0.0, 0.0, SPEED_LIMIT_M_S + 1.0), 0.3, "velocity_out_of_range"),
        ((0.0, -SPEED_LIMIT_M_S - 1.0, 0.0), 0.3, "velocity_out_of_range"),
        ((SPEED_LIMIT_M_S, -SPEED_LIMIT_M_S, 0.0), 0.3, None),
    ],
)
def test_what_cannot_be_a_velocity_is_refused(velocity, sigma, reason):
    assert refusal_of_velocity(VelocitySample(0, velocity, True, sigma)) == reason


def test_how_well_reports_agreed_before_a_hole_does_not_count_after_it():
    known = Scatter(2.0, innovation=0.01, reports=900.0, latest=(1.0, 2.0, 3.0), together=0.1)
    before = Agreements(Agreement(known, 0.2, 0.7), Agreement())
    for dt, scatter in ((1.0, known), (1.1, known._replace(innovation=1.0, reports=1.0))):
        by_filter, by_receiver = wait_for_reports(before, dt)
        assert by_filter == Agreement(scatter, 0.2 + dt, 0.7)
        assert by_receiver == Agreement()._replace(wait_s=dt)


SWING = 7.0  # rad/s


def velocity(t):
    return (sin(SWING * t), 2.0 * t, 0.5 * t * t)


def acceleration(t):
    return (SWING * cos(SWING * t), 2.0, t)


def flown(seconds, dt):
    """The velocity history after so long a flight, and its end."""
    history, t = new_velocity_history(acceleration(0.0)), 0.0
    while t < seconds - 1e-9:
        gained = tuple(b - a for a, b in zip(velocity(t), velocity(t + dt), strict=True))
        t += dt
        history = extend_velocity_history(history, gained, acceleration(t), dt)
    return history, t


def test_outside_the_history_the_acceleration_goes_on():
    """Ahead of the newest sample its own, before the beginning the oldest."""
    history, t = flown(1.0, 0.02)
    ahead_m_s = look_back(history, -0.01)[0]
    assert ahead_m_s == pytest.approx([-0.01 * a for a in acceleration(t)])
    history, t = flown(0.1, 0.02)
    wanted = np.subtract(velocity(t), velocity(0.0)) + np.multiply(0.2, acceleration(0.0))
    assert look_back(history, 0.3)[0] == pytest.approx(wanted, abs=1e-9)


def test_quick_samples_do_not_shorten_the_history():
    history, _ = flown(1.0, 0.0025)
    assert history[0, 0] - history[ROWS - 1, 0] > 0.5
