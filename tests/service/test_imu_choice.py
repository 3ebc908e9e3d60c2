import random

import pytest

from service.imu_stream import (
    LONGEST_SILENCE_US,
    ImuChoice,
    consider,
    doubt,
    patience_us,
    trust_all,
)

LATE_US = 500_000


def feed(choice, *messages, start_us=0, step_us=10_000):
    for number, message in enumerate(messages):
        choice = consider(choice, message, start_us + number * step_us, LATE_US)
    return choice


def test_the_first_message_is_taken():
    assert feed(ImuChoice(), "SCALED_IMU2").message == "SCALED_IMU2"


def test_other_messages_of_a_batch_do_not_interfere():
    batch = ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")
    assert feed(ImuChoice(), *(batch * 20)).message == "RAW_IMU"


def test_a_preferred_message_takes_over_once_it_is_steady():
    choice = feed(ImuChoice(), "SCALED_IMU2", "RAW_IMU", "SCALED_IMU2", "RAW_IMU")
    assert choice.message == "SCALED_IMU2"
    assert feed(choice, "RAW_IMU", start_us=40_000).message == "RAW_IMU"


def test_a_preferred_message_now_and_then_does_not():
    choice = feed(ImuChoice(), "HIGHRES_IMU")
    for second in range(20):
        choice = feed(choice, "RAW_IMU", *["HIGHRES_IMU"] * 50, start_us=second * 1_000_000)
        assert choice.message == "HIGHRES_IMU"


def test_change_over_when_the_chosen_one_is_silent_while_the_other_comes():
    """At 50 Hz after half a second, and not by what comes first after an outage of both."""
    choice = feed(ImuChoice(), "RAW_IMU")
    choice = feed(choice, *["SCALED_IMU2"] * 50, start_us=60_000_000)  # after a minute of nothing
    assert choice.message == "RAW_IMU"
    assert feed(choice, "SCALED_IMU2", start_us=60_500_000).message == "SCALED_IMU2"


def alternate(drops, period_us, seconds, seed=0):
    """The changes of message on a link that drops RAW_IMU in ``drops`` (s, s), the other never."""
    rng, choice, used = random.Random(seed), ImuChoice(), []
    for k in range(round(seconds * 1e6 / period_us)):
        now_us = k * period_us
        lost = any(a <= now_us / 1e6 < b for a, b in drops) or (k > 0 and rng.random() < 0.2)
        for name in ([] if lost else ["RAW_IMU"]) + ["SCALED_IMU2"]:
            late_us = max(LATE_US, 3 * period_us)
            choice = consider(choice, name, now_us, late_us, float(period_us))
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
    choice = feed(ImuChoice(), "RAW_IMU")
    for k in range(60):
        choice = feed(choice, "SCALED_IMU3", "SCALED_IMU2", start_us=20_000 * (k + 1), step_us=10)
    assert choice.message == "SCALED_IMU2"


def test_names_of_log_formats_are_usable():
    assert feed(ImuChoice(), "sensor_combined", "IMU").message == "sensor_combined"


def test_a_slow_but_steady_preferred_message_proves_itself_by_its_last_arrival():
    """RAW_IMU at 2.5 Hz beside a fast second IMU: each is in time for the one before it."""
    choice = feed(ImuChoice(), "SCALED_IMU2")
    for k in range(1, 3):
        choice = feed(choice, "SCALED_IMU2", "RAW_IMU", start_us=400_000 * k)
        assert choice.message == "SCALED_IMU2"
    choice = feed(choice, "SCALED_IMU2", "RAW_IMU", start_us=1_200_000)
    assert choice.message == "RAW_IMU"


def test_one_that_pauses_begins_anew():
    choice = feed(ImuChoice(), "SCALED_IMU2", "RAW_IMU", "RAW_IMU", "SCALED_IMU2")
    for k in range(5):
        choice = feed(choice, "SCALED_IMU2", start_us=300_000 * (k + 1))
    assert feed(choice, "RAW_IMU", start_us=1_510_000).message == "SCALED_IMU2"


@pytest.mark.parametrize(
    ("silence_us", "patience"),
    [(LONGEST_SILENCE_US, 2 * LONGEST_SILENCE_US), (LONGEST_SILENCE_US + 1, LATE_US)],
)
def test_a_silence_so_long_that_the_vehicle_was_gone_says_nothing_of_the_message(
    silence_us, patience
):
    choice = feed(feed(ImuChoice(), "RAW_IMU"), "RAW_IMU", start_us=silence_us)
    assert patience_us(choice, LATE_US, 0.0) == patience


def test_another_message_is_used_while_the_gyroscope_of_the_first_is_doubted():
    """And once that one's is doubted as well, nothing speaks against the first more than it."""
    both = ("RAW_IMU", "SCALED_IMU2") * 3
    choice = feed(doubt(feed(ImuChoice(), *both)), *both, start_us=100_000)
    assert choice.message == "SCALED_IMU2"
    assert feed(choice, *both * 100, start_us=200_000).message == "SCALED_IMU2"
    assert feed(trust_all(choice), *both, start_us=200_000).message == "RAW_IMU"
    choice = feed(doubt(choice), *both, start_us=200_000)
    assert choice.message == "RAW_IMU"
    assert feed(doubt(choice), *both * 100, start_us=300_000).message == "RAW_IMU"


def test_a_doubted_message_stands_in_where_the_other_falls_silent():
    both = ("RAW_IMU", "SCALED_IMU2") * 3
    choice = feed(doubt(feed(ImuChoice(), *both)), *both, start_us=100_000)
    assert feed(choice, *["RAW_IMU"] * 60, start_us=200_000).message == "RAW_IMU"


def test_nothing_is_doubted_before_there_is_a_message():
    assert doubt(ImuChoice()) == ImuChoice()
