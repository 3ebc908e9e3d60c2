"""Which IMU message and which reports are used, and what silence makes of the state."""

import random

import pytest

from drivers.events import Report, VehicleId
from estimator.types import VelocitySample
from service.records import State
from service.stream_state import LONGEST_SILENCE_US, ImuChoice, ImuStream

LATE_US = 500_000
BOTH = ("RAW_IMU", "SCALED_IMU2") * 3


def feed(choice, *messages, start_us=0, step_us=10_000):
    """The message in use after these."""
    for number, message in enumerate(messages):
        choice.consider(message, start_us + number * step_us)
    return choice.message


@pytest.mark.parametrize(
    ("messages", "used"),
    [
        (["SCALED_IMU2"], "SCALED_IMU2"),
        (["RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"] * 20, "RAW_IMU"),
        (["SCALED_IMU2", "RAW_IMU", "SCALED_IMU2", "RAW_IMU"], "SCALED_IMU2"),
        (["SCALED_IMU2", "RAW_IMU", "SCALED_IMU2", "RAW_IMU", "RAW_IMU"], "RAW_IMU"),  # steady
        (["sensor_combined", "IMU"], "sensor_combined"),  # of log formats
    ],
)
def test_the_first_is_used_until_a_better_one_is_steady(messages, used):
    assert feed(ImuChoice(), *messages) == used


def test_a_preferred_message_now_and_then_does_not_take_over():
    choice = ImuChoice("HIGHRES_IMU")
    for second in range(20):
        used = feed(choice, "RAW_IMU", *["HIGHRES_IMU"] * 50, start_us=second * 1_000_000)
        assert used == "HIGHRES_IMU"


def test_change_over_when_the_chosen_one_is_silent_while_the_other_comes():
    """At 50 Hz after half a second, but not by the first message after an outage of both."""
    choice = ImuChoice()
    feed(choice, "RAW_IMU")  # and after a minute of nothing:
    assert feed(choice, *["SCALED_IMU2"] * 50, start_us=60_000_000) == "RAW_IMU"
    assert feed(choice, "SCALED_IMU2", start_us=60_500_000) == "SCALED_IMU2"


def alternate(drops, period_us, seconds, seed=0):
    """The changes of message on a link that drops RAW_IMU in ``drops`` (s, s), the other never."""
    rng, choice, used = random.Random(seed), ImuChoice(), []
    for k in range(round(seconds * 1e6 / period_us)):
        now_us = k * period_us
        lost = any(a <= now_us / 1e6 < b for a, b in drops) or (k > 0 and rng.random() < 0.2)
        for name in ([] if lost else ["RAW_IMU"]) + ["SCALED_IMU2"]:
            choice.consider(name, now_us, float(period_us))
            if not used or used[-1] != choice.message:
                used.append(choice.message)
    return used


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("period_us", [250_000, 400_000])
def test_a_lossy_link_does_not_make_two_imus_alternate(period_us, seed):
    """Holes of 3 to 4.5 s in one message, every 20 s: 21 changes to and fro before."""
    drops = [(20 * k + 5, 20 * k + 8 + 0.3 * (k % 6)) for k in range(20)]
    assert alternate(drops, period_us, 400, seed) == ["RAW_IMU"]


def test_an_imu_that_is_gone_is_replaced_and_used_again_when_it_is_back_for_good():
    gone, flicker = (60, 100), [(100 + k, 100.7 + k) for k in range(10)]
    used = alternate([gone, *flicker], 250_000, 90)
    assert used == ["RAW_IMU", "SCALED_IMU2"]
    assert alternate([gone, *flicker], 250_000, 110) == used
    assert alternate([gone, *flicker], 250_000, 200) == [*used, "RAW_IMU"]


def test_the_second_imu_is_the_stand_in_not_the_third():
    choice = ImuChoice("RAW_IMU")
    for k in range(60):
        used = feed(choice, "SCALED_IMU3", "SCALED_IMU2", start_us=20_000 * (k + 1), step_us=10)
    assert used == "SCALED_IMU2"


def test_a_slow_but_steady_preferred_message_proves_itself_by_its_last_arrival():
    """RAW_IMU at 2.5 Hz beside a fast second IMU: each is in time for the one before it."""
    choice = ImuChoice("SCALED_IMU2")
    used = [feed(choice, "SCALED_IMU2", "RAW_IMU", start_us=400_000 * k) for k in range(1, 4)]
    assert used == ["SCALED_IMU2", "SCALED_IMU2", "RAW_IMU"]


def test_a_stand_in_may_come_once_a_second():
    choice = ImuChoice("RAW_IMU")
    used = [feed(choice, "SCALED_IMU2", start_us=1_000_000 * second) for second in range(1, 5)]
    assert used == ["RAW_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU2"]


def test_one_that_pauses_begins_anew():
    choice = ImuChoice("SCALED_IMU2")
    feed(choice, "RAW_IMU", "RAW_IMU", "SCALED_IMU2", start_us=10_000)
    for k in range(5):
        feed(choice, "SCALED_IMU2", start_us=300_000 * (k + 1))
    assert feed(choice, "RAW_IMU", start_us=1_510_000) == "SCALED_IMU2"


@pytest.mark.parametrize(
    ("silence_us", "patience"),
    [(LONGEST_SILENCE_US, 2 * LONGEST_SILENCE_US), (LONGEST_SILENCE_US + 1, LATE_US)],
)
def test_a_silence_so_long_that_the_vehicle_was_gone_is_not_the_message_s(silence_us, patience):
    choice = ImuChoice()
    feed(choice, "RAW_IMU", "RAW_IMU", step_us=silence_us)
    assert choice.patience_us(0.0) == patience


def test_another_message_is_used_while_the_gyroscope_of_the_first_is_contradicted():
    """Once the other gyroscope is contradicted as well, the first message is used again."""
    choice = ImuChoice()
    feed(choice, *BOTH)
    choice.contradicted.add(choice.message)
    assert feed(choice, *BOTH, start_us=100_000) == "SCALED_IMU2"
    assert feed(choice, *BOTH * 100, start_us=200_000) == "SCALED_IMU2"
    choice.contradicted.add(choice.message)
    assert feed(choice, *BOTH, start_us=7_000_000) == "RAW_IMU"
    choice.contradicted.add(choice.message)
    assert feed(choice, *BOTH * 100, start_us=8_000_000) == "RAW_IMU"


def test_a_contradicted_message_stands_in_and_is_used_again_after_a_reboot():
    choices = ImuStream(), ImuStream()
    for stream in choices:
        feed(stream.choice, *BOTH)
        stream.choice.contradicted.add(stream.choice.message)
        assert feed(stream.choice, *BOTH, start_us=100_000) == "SCALED_IMU2"
    assert feed(choices[0].choice, *["RAW_IMU"] * 60, start_us=200_000) == "RAW_IMU"
    choices[1].note_reboot()
    assert feed(choices[1].choice, *BOTH, start_us=200_000) == "RAW_IMU"


GPS, GLOBAL, LOCAL = "GPS_RAW_INT", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"


@pytest.mark.parametrize(
    ("arrivals", "taken"),
    [
        ([(GPS, 0), (GLOBAL, 10), (GPS, 20), (LOCAL, 30), (GLOBAL, 40)], "++-+-"),
        ([(LOCAL, 0), (GLOBAL, 2_000_000), (GLOBAL, 2_000_001), (LOCAL, 2_000_002)], "+-++"),
        (  # silence counts from the last of its messages
            [
                (LOCAL, 0),
                (LOCAL, 1_500_000),
                (GLOBAL, 3_000_000),
                (GPS, 3_600_000),
                (GLOBAL, 3_700_000),
            ],
            "++-++",
        ),
        ([("somebody", 0), (GPS, 1), ("somebody", 2)], "++-"),
    ],
)
def test_of_reports_the_best_one_that_comes_is_used(arrivals, taken):
    stream, sample = ImuStream(), VelocitySample(0, (0.0, 0.0, 0.0), True, 0.3)
    found = [stream.uses(Report(VehicleId(1, 1), us, name, sample)) for name, us in arrivals]
    assert "".join("-+"[each] for each in found) == taken


@pytest.mark.parametrize(
    ("period_us", "late_us", "lost_us"),
    [(0, 5e5, 5e6), (10_000, 5e5, 5e6), (250_000, 7.5e5, 5e6), (1_000_000, 3e6, 10e6)],
)
def test_silence_degrades_then_loses_and_slow_streams_are_given_more_time(
    period_us, late_us, lost_us
):
    stream = ImuStream()
    assert stream.state_at(10**12) is State.WAITING
    stream.median_period_us, stream.last_arrival_us = float(period_us), 10**9
    assert (stream.late_after_us, stream.lost_after_us) == (late_us, lost_us)
    late_us, lost_us = 10**9 + int(late_us), 10**9 + int(lost_us)
    times_us = [0, late_us - 1, late_us, lost_us - 1, lost_us]  # 0: the host's clock was set back
    expected = {
        State.RUNNING: ["running", "running", "degraded", "degraded", "lost"],
        State.DEGRADED: ["degraded"] * 4 + ["lost"],
        State.ALIGNING: ["aligning"] * 4 + ["lost"],
        State.LOST: ["lost"] * 5,
    }
    for stream.state, states in expected.items():
        assert [stream.state_at(now_us) for now_us in times_us] == states
