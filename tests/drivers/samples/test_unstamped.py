"""Attitudes without a time of their own, and fields that are logged beside the samples."""

import math

import pytest

from drivers.events import ReferenceAttitude
from drivers.logs.logged_vehicle import LoggedVehicle
from drivers.samples.imu_stream import RepeatedField
from drivers.samples.intake import Intake
from estimator.types import IDENTITY, ZERO_VEC3
from tests.drivers.mavlink.messages import only
from tests.drivers.samples.given import FIELD, REST, UNIX, VEHICLE, S, imu, running


def test_truth_has_the_time_of_the_last_imu_message():
    intake, _ = running()
    (truth,) = intake.unstamped("SIM_STATE", UNIX, "sim", IDENTITY)
    assert (truth.time_us, truth.source) == (301 * S, "sim")
    assert intake.unstamped("SIM_STATE", UNIX, "sim", IDENTITY) == []
    (other,) = intake.unstamped("SIMSTATE", UNIX, "sim", IDENTITY)
    assert other.time_us == 301 * S
    assert intake.unstamped("SIM_STATE", UNIX, "sim", None) == []
    assert Intake(VEHICLE).unstamped("SIM_STATE", UNIX, "sim", IDENTITY) == []


def logged(stale_us=0):
    vehicle = LoggedVehicle(VEHICLE, 0)
    vehicle.at(S)
    vehicle.put_mag(FIELD)
    vehicle.at(S + stale_us)
    return vehicle, vehicle.imu("IMU", ZERO_VEC3, REST)


@pytest.mark.parametrize(
    ("age_us", "expected"), [(200_000, True), (200_001, False), (-200_000, True), (-200_001, False)]
)
def test_a_logged_field_gets_stale(age_us, expected):
    _, (event,) = logged(stale_us=age_us)
    assert event.sample.has_mag is expected


def test_a_logged_field_that_is_no_number_is_none():
    vehicle, _ = logged()
    vehicle.put_mag((math.nan, 0.0, 0.4))
    (event,) = vehicle.imu("IMU2", ZERO_VEC3, REST)
    assert not event.sample.has_mag


def test_an_autopilot_s_unstamped_attitude_is_taken_if_it_sends_no_other():
    intake = Intake(VEHICLE)
    imu(intake, S)
    (event,) = intake.unstamped("AHRS2", UNIX, "autopilot", IDENTITY)
    assert (event.source, event.time_us) == ("autopilot", S)
    imu(intake, 2 * S)
    assert intake.wants_attitude(UNIX + S)
    assert intake.unstamped("AHRS2", UNIX + S, "autopilot", IDENTITY) == []


@pytest.mark.parametrize("ahead_us", [0, 300, 1_900])
def test_a_simulators_attitude_belongs_to_the_imu_message_that_it_comes_with(ahead_us):
    """SIM_STATE has no stamp; some send it right before the IMU message of its time."""
    intake, times_us = Intake(VEHICLE), []
    for k in range(1, 6):
        at_us = UNIX + k * S // 4
        truth = intake.unstamped("SIM_STATE", at_us - ahead_us, "sim", IDENTITY)
        times_us += [
            e.time_us for e in only(ReferenceAttitude, truth + imu(intake, k * S // 4, at_us))
        ]
    assert times_us == [k * S // 4 for k in range(2, 6)]


@pytest.mark.parametrize("ends", [True, False])
def test_an_attitude_that_waits_is_the_last_samples_at_the_end_or_if_the_host_is_set_back(ends):
    intake, _ = running()
    assert intake.unstamped("SIM_STATE", UNIX + 301 * S + 90_000, "sim", IDENTITY) == []
    events = intake.end() if ends else imu(intake, 301 * S + 250_000, UNIX - 3600 * S)
    assert [e.time_us for e in only(ReferenceAttitude, events)] == [301 * S]
    assert intake.end() == []


def test_a_simulators_attitude_right_behind_its_imu_message_does_not_wait():
    intake = Intake(VEHICLE)
    for k in range(1, 4):
        imu(intake, k * S // 4)
        (event,) = intake.unstamped("SIM_STATE", UNIX + k * S // 4 + 500, "sim", IDENTITY)
        assert event.time_us == k * S // 4
    assert intake.unstamped("SIM_STATE", UNIX + 3 * S // 4 + 90_000, "sim", IDENTITY) == []
    # that one's own IMU message was lost, and it is a second of the third
    assert not only(ReferenceAttitude, imu(intake, S))


def test_a_field_repeated_after_the_clock_went_back_is_new():
    field = RepeatedField()
    times_us = (1_000_000, 1_239_999, 1_240_000, 1_100_000)
    assert [field.is_fresh(FIELD, us) for us in times_us] == [True, False, True, True]
