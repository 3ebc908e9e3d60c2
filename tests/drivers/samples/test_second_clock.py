"""Messages whose clock is another one than the IMU's, or the same in another field."""

import itertools

import pytest

from drivers.samples.vehicle_clock import Placed, VehicleClock
from estimator.reasons import Reason
from tests.drivers.samples.test_vehicle_clock import BOOT_MS, GPS, UNIX, USEC, S, imu


@pytest.mark.parametrize("step_us", [1_900_000, -1_900_000, 700_000])
def test_a_leap_and_back_of_which_two_messages_of_a_moment_speak(step_us):
    """An IMU message and an attitude with one stamp: each costs a few of them, and no more."""
    clock, refused = VehicleClock(), []
    for k in range(2000):
        raw_us = 100 * S + 20_000 * k + step_us * (800 <= k < 1100)
        now_us = UNIX + 20_000 * k
        imu(clock, raw_us, now_us)
        results = (
            imu(clock, raw_us, now_us, BOOT_MS, "SCALED_IMU2"),
            clock.place("ATTITUDE", BOOT_MS, raw_us, now_us),
        )
        refused += [k for each in results if isinstance(each, Reason)]
    assert len(refused) <= 12
    assert set(refused) <= {*range(800, 803), *range(1100, 1103)}


def feed_both(clock, count, offset_us, phase_us=100_000, jitter=lambda _: 0, first_us=100 * S):
    """IMU at 4 Hz, an attitude ``phase_us`` behind each whose clock is ``offset_us`` ahead."""
    placed = []
    for k in range(count):
        true_us = first_us + 250_000 * k
        imu(clock, true_us, UNIX + true_us + jitter(k))
        raw_us = (true_us + phase_us + offset_us) // 1000 * 1000
        arrival_us = UNIX + true_us + phase_us + jitter(k + 1)
        placed.append((true_us + phase_us, clock.place("ATTITUDE", BOOT_MS, raw_us, arrival_us)))
    return placed


@pytest.mark.parametrize(
    ("count", "offset_us", "jitter_us", "early_us", "late_us"),
    [
        (100, 0, 70_000, 0, 1000),  # exactly; time_boot_ms is truncated
        # Copter 3.1 and 3.2: 2.3 to 2.6 s; to a twentieth of such a log's interval
        (100, 2_526_000, 3_000, -20_000, 20_000),
        (50, 2**32, 0, -1000, 1000),  # had wrapped before the log began
    ],
    ids=["one clock", "a constant offset", "wrapped"],
)
def test_two_fields_keep_the_phase_between_them(count, offset_us, jitter_us, early_us, late_us):
    placed = feed_both(VehicleClock(), count, offset_us, jitter=lambda k: jitter_us * (k % 5))
    assert all(early_us <= true_us - p.time_us < late_us for true_us, p in placed)


def test_time_grows_although_a_learnt_offset_moves_by_more_than_a_step():
    """The first message was 0.4 s late, so that its clock seemed to be less far ahead."""
    clock = VehicleClock()
    imu(clock, 100 * S, UNIX)
    late = clock.place("ATTITUDE", BOOT_MS, 103 * S, UNIX + 400_000)
    prompt = clock.place("ATTITUDE", BOOT_MS, 103 * S + 20_000, UNIX + 20_000)
    assert prompt.time_us == late.time_us + 1


@pytest.mark.parametrize(
    ("off_us", "late_us", "shown_us"), [(UNIX - 7 * S, 0, 50_000), (-160_000, -160_000, 0)]
)
def test_gps_time_may_be_unix_time_or_since_boot(off_us, late_us, shown_us):
    """Since boot it keeps its latency; Unix time contains the link's 50 ms."""
    clock = VehicleClock()
    for k in range(40):
        true_us = 100 * S + 200_000 * k
        imu(clock, true_us, UNIX + true_us)
        placed = clock.place("GPS_RAW_INT", GPS, off_us + true_us, UNIX + true_us + shown_us)
        assert abs(placed.time_us - true_us - late_us) < 1.2 * shown_us + 1


def test_nothing_else_has_a_time_before_the_first_imu_message():
    assert VehicleClock().place("ATTITUDE", BOOT_MS, S, UNIX) == "no_clock"


@pytest.mark.parametrize("back_us", [200_000, 500_000, 900_000])
def test_a_clock_in_two_fields_that_is_set_back_and_forwards_invents_no_time(back_us):
    """Attitudes come ahead of their samples, too seldom to show it all by themselves."""
    clock, given_us = VehicleClock(), []
    for k in range(50 * 40):
        now_us = 100 * S + 20_000 * k
        raw_us = now_us - (back_us if k % 1000 > 600 else 0)
        if k % 10 == 0:
            clock.place("ATTITUDE", BOOT_MS, raw_us // 1000 * 1000, UNIX + now_us)
        placed = imu(clock, raw_us, UNIX + now_us + 500)
        given_us += [placed.time_us] if isinstance(placed, Placed) else []
    assert given_us[-1] - given_us[0] == 20_000 * (50 * 40 - 1)
    assert max(b - a for a, b in itertools.pairwise(given_us)) <= 60_000  # two wait for the third


def test_reports_keep_their_intervals_where_their_own_clock_takes_over():
    """The first three came 0.4 s late, so that prompt ones are placed ahead until then."""
    clock = VehicleClock()
    imu(clock, 100 * S, UNIX, BOOT_MS, "SCALED_IMU2")

    def report(after_us, late_us=0):
        return clock.place("REPORT", USEC, 5000 * S + after_us, UNIX + after_us + late_us).time_us

    for k in range(3):
        report(20_000 * k, late_us=400_000)
    before_us = report(500_000)
    imu(clock, 5000 * S + 520_000, UNIX + 520_000)
    assert report(540_000) - before_us == pytest.approx(30_000, abs=10_000)


def test_a_clock_beside_the_line_that_leaps_alone_is_learnt_anew():
    clock = VehicleClock()
    feed_both(clock, 40, 0)
    after = feed_both(clock, 40, 100 * S, first_us=110 * S)
    placed = [(true_us, each) for true_us, each in after if isinstance(each, Placed)]
    assert len(placed) > 33
    assert all(abs(true_us - each.time_us) < 20_000 for true_us, each in placed)
