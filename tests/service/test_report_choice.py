"""Which of several messages that report the same is used."""

from drivers.events import Report, VehicleId
from estimator.types import VelocitySample
from service.imu_stream import ReportChoices


def after(*arrivals):
    choices, sample = ReportChoices(), VelocitySample(0, (0.0, 0.0, 0.0), True, 0.3)
    return [choices.take(Report(VehicleId(1, 1), us, name, sample)) for name, us in arrivals]


def test_the_first_is_used_until_a_better_one_comes():
    assert after(
        ("GPS_RAW_INT", 0),
        ("GLOBAL_POSITION_INT", 10),
        ("GPS_RAW_INT", 20),
        ("LOCAL_POSITION_NED", 30),
        ("GLOBAL_POSITION_INT", 40),
    ) == [True, True, False, True, False]


def test_two_seconds_of_silence_hand_over_to_the_next_best():
    assert after(
        ("LOCAL_POSITION_NED", 0),
        ("GLOBAL_POSITION_INT", 2_000_000),
        ("GLOBAL_POSITION_INT", 2_000_001),
        ("LOCAL_POSITION_NED", 2_000_002),
    ) == [True, False, True, True]


def test_silence_is_counted_from_the_last_of_its_messages():
    assert after(
        ("LOCAL_POSITION_NED", 0),
        ("LOCAL_POSITION_NED", 1_500_000),
        ("GLOBAL_POSITION_INT", 3_000_000),
        ("GPS_RAW_INT", 3_600_000),
        ("GLOBAL_POSITION_INT", 3_700_000),
    ) == [True, True, False, True, True]


def test_an_unknown_message_is_better_than_none():
    assert after(("somebody", 0), ("GPS_RAW_INT", 1), ("somebody", 2)) == [True, True, False]
