"""A source of aiding from outside: one file, and one line in the table of sources."""

from math import nan, remainder, tau

import pytest

from estimator.aiding.sources.source import SOURCES
from estimator.aiding.types import SIZE
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.geometry.frames import euler_rad
from estimator.profile import load_profile
from tests.estimator.aiding.heading_source import HEADING_SOURCE, HeadingSample
from tests.flight import banked_flight, north_known, taken_along

SAMPLES = 200


@pytest.fixture(autouse=True)
def known(monkeypatch):
    monkeypatch.setitem(SOURCES, HeadingSample, HEADING_SOURCE)


@pytest.fixture(scope="module")
def flying():
    """A flight, and the state in it while velocity helps."""
    flight = banked_flight(seconds=5.0)
    estimator = taken_along(north_known(), flight, SAMPLES)
    return flight, estimator.profile, estimator.snapshot


def heading_of(estimator):
    return euler_rad(estimator.snapshot.core.aided.estimate.q_ned_frd)[2]


@pytest.mark.parametrize("ahead", [False, True])
def test_its_report_moves_what_it_measures_and_what_is_tied_to_that(flying, ahead):
    """A sure one nearly all the way, ahead of the IMU as soon as that has reached it."""
    flight, profile, state = flying
    estimator, without = Estimator(profile), Estimator(profile)
    estimator.snapshot = without.snapshot = state
    time_us = flight.samples[SAMPLES - 1 + ahead].time_us
    before = heading_of(estimator)
    report = HeadingSample(time_us, before + 0.05, 1e-4)
    assert estimator.update_report(report) is None
    if ahead:
        assert heading_of(estimator) == before
        estimator.update(flight.samples[SAMPLES])
        without.update(flight.samples[SAMPLES])
    turned = remainder(heading_of(estimator) - heading_of(without), tau)
    assert turned == pytest.approx(0.05, abs=0.003)
    variance = estimator.snapshot.core.covariance[2 * SIZE + 2]
    assert variance == pytest.approx(1e-8, rel=0.3)
    bias = [e.snapshot.core.aided.estimate.gyr_bias_rad_s for e in (estimator, without)]
    assert bias[0] != bias[1]


def test_it_resumes_from_a_snapshot_with_reports_that_wait(flying):
    flight, profile, state = flying
    one, other = Estimator(profile), Estimator(profile)
    one.snapshot = state
    one.update_report(HeadingSample(flight.samples[SAMPLES].time_us, 0.3, 0.01))
    other.snapshot = one.snapshot
    for estimator in (one, other):
        estimator.update(flight.samples[SAMPLES])
    assert one.snapshot == other.snapshot


def test_integers_are_taken_as_floats(flying):
    _, profile, state = flying
    one, other = Estimator(profile), Estimator(profile)
    for estimator, number in ((one, 1), (other, 1.0)):
        estimator.snapshot = state
        estimator.update_report(HeadingSample(state.core.time_us, number, number))
    assert one.snapshot == other.snapshot


def test_it_waits_for_velocity_and_is_refused_where_it_is_no_number():
    estimator = Estimator(load_profile("imu"))
    before = estimator.snapshot
    assert estimator.update_report(HeadingSample(0, nan, 0.1)) == "not_finite"
    assert estimator.update_report(HeadingSample(0, 0.5, 0.1)) is None
    assert estimator.snapshot == before


@pytest.mark.parametrize(
    "report", [None, (0, 0.1, 0.1), HeadingSample(0, None, 0.1), HeadingSample(0, (0.0,), 0.1)]
)
def test_what_no_source_reports_is_an_error_that_names_it(report):
    with pytest.raises(InputError, match=r"no source of aiding|stands where"):
        Estimator(load_profile("imu")).update_report(report)
