"""The vehicle's time: continuous whatever the vehicle, the link and the recorder do."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.samples.vehicle_clock import Placed, TimeField, VehicleClock
from estimator.reasons import Reason
from tests.drivers.mavlink.messages import UNIX, S

USEC, BOOT_MS, GPS = TimeField.TIME_USEC, TimeField.BOOT_MS, TimeField.GPS
steps_us = st.lists(st.integers(2_000, 2 * S), min_size=2, max_size=60)
lateness_us = st.lists(st.integers(0, 4 * S), min_size=60, max_size=60)  # up to 4 s, as measured


def imu(clock, raw_us, arrival_us, field=USEC, message="RAW_IMU"):
    return clock.place(message, field, raw_us, arrival_us, is_imu=True)


def steady(clock, first_us, count, step_us=250_000, arrival_us=UNIX):
    """Feed a steady stream; the results, and the arrival time behind the last."""
    end_us = count * step_us
    results = [imu(clock, first_us + us, arrival_us + us) for us in range(0, end_us, step_us)]
    return results, arrival_us + end_us


def times(results):
    return [placed.time_us for placed in results if isinstance(placed, Placed)]


def resets(results):
    return [p.reset for p in results if isinstance(p, Placed) and p.reset is not None]


@given(st.integers(0, 2**50), steps_us, lateness_us)
def test_intervals_are_the_vehicles_own_however_late_samples_arrive(first_us, steps, late):
    clock, raw_us, results = VehicleClock(), first_us, []
    for step_us, late_us in zip(steps, late, strict=False):
        results.append(imu(clock, raw_us, UNIX + raw_us - first_us + late_us))
        raw_us += step_us
    given_us = times(results)
    assert len(given_us) == len(steps)
    assert [b - a for a, b in itertools.pairwise(given_us)] == steps[:-1]
    assert not resets(results)


def test_milliseconds_wrap_after_49_days_and_longer_clocks_do_not():
    clock, wrap_ms = VehicleClock(), 2**32
    raws = [((wrap_ms - 500 + 250 * k) % wrap_ms) * 1000 for k in range(6)]
    results = [imu(clock, raw, UNIX + 250_000 * k, BOOT_MS) for k, raw in enumerate(raws)]
    assert {b - a for a, b in itertools.pairwise(times(results))} == {250_000}
    results, _ = steady(VehicleClock(), 2**32 - 500_000, 6)
    assert times(results)[-1] == 2**32 + 750_000


# Steady stretches: the first time (s), how many, the seconds between them, and what passed before
# by the arrivals; and the resets between them
DAY_S = 86_400.0
STRETCHES = {
    "a reboot 57 s before the clock would wrap": (
        [(2**32 / S - 60.0, 10, 0.25, 0.0), (3.0, 5, 0.25, 0.0)],
        ["reboot"],
    ),
    "a real gap": ([(10.0, 5, 0.25, 0.0), (141.0, 5, 0.25, 129.0)], []),
    "held back by 12 s for three minutes, then prompt": (
        [(10.0, 40, 0.25, 0.0), (20.0, 720, 0.25, 12.0), (212.0, 5, 0.25, 0.0)],
        [],
    ),
    "prompt, and a step of less than five seconds": (
        [(10.0, 20, 0.02, 0.0), (15.28, 3, 0.02, -0.02)],
        [],
    ),
    # a PX4 bench recording does this: no gap, 272 s within one arrival
    "prompt, and a step of minutes": ([(2.37, 10, 0.25, 0.0), (275.66, 10, 0.25, 0.0)], ["jump"]),
    "prompt, and a step of more": ([(10.0, 20, 0.02, 0.0), (15.48, 6, 0.02, -0.02)], ["jump"]),
    "two sessions, ten seconds apart by the clock and ten minutes by the arrivals": (
        [(50.0, 5, 0.25, 0.0), (61.0, 5, 0.25, 600.0)],
        ["jump"],
    ),
    "a reboot while the host's clock is set back": (
        [(300.0, 10, 0.25, 0.0), (3.0, 5, 0.25, -3600.0)],
        ["reboot"],
    ),
    "a leap after the host's clock was set": (
        [(50.0, 5, 0.25, 0.0), (51.25, 20, 0.25, DAY_S), (76.25, 6, 0.25, 0.0)],
        ["jump"],
    ),
}


@pytest.mark.parametrize(("stretches", "reasons"), STRETCHES.values(), ids=STRETCHES)
def test_what_is_a_reset_and_what_is_time(stretches, reasons):
    clock, arrival_us, results, raws_us = VehicleClock(), UNIX, [], []
    for first_s, count, step_s, passed_s in stretches:
        arrival_us += round(passed_s * S)
        first_us, step_us = round(first_s * S), round(step_s * S)
        raws_us += [first_us + k * step_us for k in range(count)]
        found, arrival_us = steady(clock, first_us, count, step_us, arrival_us)
        results += found
    assert [reset.reason for reset in resets(results)] == reasons
    if not reasons:
        assert times(results) == raws_us
    else:  # a sample waits for the next to agree
        assert {each for each in results if isinstance(each, Reason)} == {"clock_step"}


def test_a_slow_clock_of_an_hour_does_not_hide_a_leap():
    """136 ms a minute slow, as measured: after an hour each sample is 8 s later than the first."""
    clock, arrival_us = VehicleClock(), UNIX
    for k in range(3600):
        assert isinstance(imu(clock, 10 * S + k * S, arrival_us), Placed)
        arrival_us += S + 2_267
    after, _ = steady(clock, 3610 * S + 7 * S, 3, arrival_us=arrival_us)
    assert [reset.reason for reset in resets(after)] == ["jump"]


@pytest.mark.parametrize(("step_s", "is_leap"), [(30, False), (34, False), (36, True), (50, True)])
def test_lateness_explains_a_step_of_thirty_seconds_at_most(step_s, is_leap):
    """Held back for 48 s in all, the samples that come then may be 30 s and 5 s apart."""
    clock = VehicleClock()
    _, arrival_us = steady(clock, 10 * S, 5)
    for k in range(3):
        arrival_us += 16 * S
        imu(clock, 11_250_000 + 250_000 * k, arrival_us)
    after, _ = steady(clock, 11_750_000 + step_s * S, 6, arrival_us=arrival_us)
    assert bool(resets(after)) is is_leap


@pytest.mark.parametrize(
    ("back_us", "word"),
    [
        (0, "duplicate"),
        (10_000, "out_of_order"),
        (990_000, "out_of_order"),
        (1_010_000, "clock_step"),
    ],
)
def test_a_second_back_is_disorder_and_more_may_be_a_reboot(back_us, word):
    clock = VehicleClock()
    _, arrival_us = steady(clock, 10 * S, 20, 20_000)
    assert imu(clock, 10_380_000 - back_us, arrival_us) == word
    assert isinstance(imu(clock, 10_380_001, arrival_us), Placed)


@pytest.mark.parametrize(("count", "takes_over"), [(50, True), (300, False)])
def test_two_vehicles_with_one_address_are_not_one_that_leaps_to_and_fro(count, takes_over):
    """Where two of the first are lost, the second one is a leap if the first has just begun."""
    clock, second, first = VehicleClock(), [], []
    _, arrival_us = steady(clock, 100 * S, count, 20_000)
    for k in range(50):
        now_us = arrival_us + 20_000 * k
        second.append(imu(clock, 900 * S + 20_000 * k, now_us))
        first_us = 100 * S + 20_000 * (count + k)
        first += [imu(clock, first_us, now_us + 5_000)] if k >= 2 else []
    used, refused = (second, first) if takes_over else (first, second)
    assert len(resets(used)) == takes_over
    assert len(times(used)) == 48 + takes_over
    reasons = [Reason.ADDRESS_CONFLICT] if takes_over else ["clock_step", "address_conflict"]
    assert set(refused) == set(reasons)


@given(st.lists(st.tuples(st.integers(0, 2**64), st.integers(0, 2**64)), max_size=80))
def test_whatever_comes_time_only_grows(samples):
    clock, last_us = VehicleClock(), -1
    for raw_us, arrival_us in samples:
        placed = imu(clock, raw_us, arrival_us)
        clock.place("ATTITUDE", BOOT_MS, raw_us % 2**32 * 1000, arrival_us)
        if isinstance(placed, Placed):
            assert placed.time_us > last_us
            last_us = placed.time_us


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
    assert clock.place("ATTITUDE", BOOT_MS, 103 * S, UNIX) == "no_clock"  # an IMU message begins
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
