"""Counts, bounds and angles of the service where they are not alike on both sides."""

import pytest

from drivers.events import Forgotten, Heartbeat, VehicleId
from estimator.geometry.earth import PlaceField
from estimator.geometry.frames import from_euler_rad
from estimator.profile import load_profile
from estimator.types import ImuSample
from service.alarms import Alarm
from service.parameters import MOST_PROFILES
from service.pipeline import Pipeline
from service.publishing import HostClock, Publishing
from service.second_opinion import Look, SecondOpinion
from tests.service.test_alarms import attitude, words

S = 1_000_000


def test_an_attitude_is_no_repetition_once_the_hosts_clock_is_set_back():
    publishing = Publishing(50.0)
    publishing.note_attitude(100 * S, 7)
    assert publishing.is_stale(100 * S + 1000, 7)
    assert not publishing.is_stale(40 * S, 7)
    assert not publishing.is_stale(100 * S + 1000, 8)


def test_of_too_many_profiles_the_one_that_was_kept_first_goes():
    pipeline = Pipeline(load_profile("paper"))
    addresses = [VehicleId(1 + n % 250, 1 + n // 250) for n in range(MOST_PROFILES + 1)]
    for address in addresses:
        pipeline.handle(Heartbeat(address, S, 3, 2))
        pipeline.replace_profile(address, {"filter": {"gamma": 0.5}})
        pipeline.handle(Forgotten(address, S))
    pipeline.tick(S)
    for address in addresses[:2]:
        pipeline.handle(Heartbeat(address, S, 3, 2))
    assert [each.profile.filter.gamma == 0.5 for each in pipeline.vehicles] == [False, True]


@pytest.mark.parametrize(("median_us", "is_held"), [(20_000.0, True), (500_000.0, False)])
def test_what_counts_as_held_back_follows_the_streams_interval(median_us, is_held):
    clock, arrival_us = HostClock(), 0
    for k in range(10):
        arrival_us = 50 * S + k * 500_000
        clock.observe(k * 500_000, arrival_us)
    taken_us, late_us = 5 * S, 300_000
    arrival_us = 55 * S + late_us
    time_us, age_us = clock.propagated_to(taken_us, arrival_us, median_us, arrival_us + 1000)
    if is_held:  # nobody knows whether those 0.3 s have passed
        assert (time_us - taken_us, age_us) == (1000, pytest.approx(late_us + 1000, abs=20_000))
    else:
        assert (time_us - taken_us, age_us) == (pytest.approx(late_us + 1000, abs=20_000), 1000)


def test_a_roll_of_almost_a_half_turn_differs_by_the_short_way():
    opinion = SecondOpinion()
    ours = attitude(q=from_euler_rad(3.12, 0.0, 0.0))
    sample = ImuSample(0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8), (0.0, 0.0, 0.0), False)
    theirs = from_euler_rad(-3.12, 0.0, 0.0)
    opinion.compare(Look(0, "ATTITUDE", theirs, ours, sample, None))
    assert opinion.record(0).roll_deg == pytest.approx(2.48, abs=0.01)


def test_between_the_poles_a_field_that_points_south_is_the_places():
    """There the declination is a half turn: 179 and -179 degrees are two apart."""
    place = PlaceField(3.124, 1.2, 0.58)
    horizontal, down = 0.58 * 0.362, 0.58 * 0.932
    field = (-horizontal, -0.0175 * horizontal, down)
    assert Alarm.FIELD_IMPOSSIBLE not in words(60, mag=field, place=place)
    north = (horizontal, 0.0, down)
    assert Alarm.FIELD_IMPOSSIBLE in words(60, mag=north, place=place)
