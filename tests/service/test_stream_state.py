"""Which IMU message and which reports are used, and what silence makes of the state."""

import random

import pytest

from drivers.events import Report, VehicleId
from estimator.types import VelocitySample
from service.records import State
from service.stream_state import LONGEST_SILENCE_US, ImuChoice, ImuStream

BOTH = ("RAW_IMU", "SCALED_IMU2") * 3


def feed(choice, *messages, start_us=0, step_us=10_000):
    """The message in use after these."""
    for number, message in enumerate(messages):
        choice.consider(message, start_us + number * step_us)
    return choice.message


RAW, SCALED, SECOND, THIRD = "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"


@pytest.mark.parametrize(
    ("messages", "used"),
    [
        ([SECOND], SECOND),
        ([RAW, SCALED, SECOND, THIRD] * 20, RAW),
        ([SECOND, RAW, SECOND, RAW], SECOND),
        ([SECOND, RAW, SECOND, RAW, RAW], RAW),  # steady
        (["sensor_combined", "IMU"], "sensor_combined"),  # of log formats
    ],
)
def test_the_first_is_used_until_a_better_one_is_steady(messages, used):
    assert feed(ImuChoice(), *messages) == used


@pytest.mark.parametrize(
    ("in_use", "stretches", "used"),
    [
        # a preferred one that comes now and then
        ("HIGHRES_IMU", [(k * 1_000_000, 10_000, RAW, *["HIGHRES_IMU"] * 50) for k in range(20)],
         ["HIGHRES_IMU"] * 20),
        # at 50 Hz after half a second of silence, but not at once after an outage of both
        (RAW, [(60_000_000, 10_000, *[SECOND] * 50), (60_500_000, 0, SECOND)], [RAW, SECOND]),
        # the second IMU is the stand-in, not the third
        (RAW, [(20_000, 20_000, *[THIRD, SECOND] * 16)], [SECOND]),
        # RAW_IMU at 2.5 Hz beside a fast second IMU: each is in time for the one before it
        (SECOND, [(400_000 * k, 10_000, SECOND, RAW) for k in range(1, 4)], [SECOND, SECOND, RAW]),
        # a stand-in may come once a second
        (RAW, [(1_000_000 * k, 0, SECOND) for k in range(1, 5)], [RAW, RAW, SECOND, SECOND]),
        # one that another has stood in for has to be back for as long
        (RAW, [(20_000, 20_000, *[SECOND] * 40), (800_000, 20_000, *[RAW, SECOND] * 9)],
         [SECOND] * 2),
        # one that pauses begins anew
        (SECOND,
         [(10_000, 10_000, RAW, RAW, SECOND), (300_000, 300_000, *[SECOND] * 5),
          (1_510_000, 0, RAW)], [SECOND] * 3),
    ],
)  # fmt: skip
def test_another_one_takes_over_once_it_has_proved_itself(in_use, stretches, used):
    """Stretches of messages: where they begin, their step (us), and the one in use after each."""
    choice = ImuChoice(in_use)
    found = [feed(choice, *each, start_us=at, step_us=step) for at, step, *each in stretches]
    assert found == used


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
    drops = [(20 * k + 5, 20 * k + 8 + 0.3 * (k % 6)) for k in range(20)]
    assert alternate(drops, period_us, 400, seed) == ["RAW_IMU"]


def test_an_imu_that_is_gone_is_replaced_and_used_again_when_it_is_back_for_good():
    gone, flicker = (60, 100), [(100 + k, 100.7 + k) for k in range(10)]
    used = alternate([gone, *flicker], 250_000, 90)
    assert used == ["RAW_IMU", "SCALED_IMU2"]
    assert alternate([gone, *flicker], 250_000, 110) == used
    assert alternate([gone, *flicker], 250_000, 200) == [*used, "RAW_IMU"]


@pytest.mark.parametrize(
    ("silence_us", "patience"),
    [(LONGEST_SILENCE_US, 2 * LONGEST_SILENCE_US), (LONGEST_SILENCE_US + 1, 500_000)],
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
        # silence counts from the last of its messages
        ([(LOCAL, 0), (LOCAL, 1_500_000), (GLOBAL, 3_000_000), (GPS, 3_600_000),
          (GLOBAL, 3_700_000)], "++-++"),
        ([("somebody", 0), (GPS, 1), ("somebody", 2)], "++-"),
    ],
)  # fmt: skip
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
