"""When attitudes leave, of which instant they are, and what is in their records."""

import random
from math import inf, nan, pi, radians

import numpy as np
import pytest

from drivers.events import Imu
from estimator.geometry.frames import from_euler_rad
from estimator.types import ImuSample
from service.pipeline import Pipeline
from service.publishing import MAX_DRIFT, HostClock, Publishing, attitude_record
from service.records import State
from tests.service.flight_rig import ONE, PAPER, START_US, attitudes
from tests.service.records import ATTITUDE

OFFSET_US = 1_700_000_000_000_000


def clock_after(*arrivals):
    """A clock after messages of the vehicle's time that arrive at the host's."""
    clock = HostClock()
    for vehicle_us, host_us in arrivals:
        clock.observe(vehicle_us, host_us)
    return clock


@pytest.mark.parametrize("drift", [0.0, 44e-3 / 60, 136e-3 / 60, -136e-3 / 60])
@pytest.mark.parametrize(("period_us", "limit_us"), [(10_000, 730), (250_000, 5_200)])
def test_the_offset_is_found_through_latency_and_drift(drift, period_us, limit_us):
    rng, times_us = random.Random(1), range(0, 2000 * period_us, period_us)
    arrivals = (us + OFFSET_US + drift * us + rng.expovariate(1 / 10_000) for us in times_us)
    clock = clock_after(*zip(times_us, map(round, arrivals), strict=True))
    # latency 10 ms: the best of the last few messages is much better than that
    true = OFFSET_US + drift * times_us[-1]
    assert abs(clock.offset_us - true) < limit_us  # measured 451 to 609, 943 to 4332


@pytest.mark.parametrize(("count", "is_step"), [(2, False), (3, True)])
def test_a_second_with_two_messages_shows_no_step(count, is_step):
    later_us = [10_000_000 + k * 1_000_000 // count for k in range(count + 1)]
    prompt = ((k * 1_000_000, k * 1_000_000) for k in range(10))
    clock = clock_after(*prompt, *((us, us + 60_000_000) for us in later_us))
    assert (clock.offset_us > 50_000_000) is is_step


def offset_us(latenesses_us):
    """Of a clock after prompt messages (2 ms) and then some that are late by so much more."""
    late = enumerate([*[0] * 100, *latenesses_us])
    return clock_after(*((k * 20_000, k * 20_000 + 2_000 + us) for k, us in late)).offset_us


@pytest.mark.parametrize(
    ("count", "step_us", "spread_us", "is_step"),
    [
        # a host clock set forwards is followed within two seconds
        *((105, step_us, 0, True) for step_us in (60_000_000, 500_000, 130_000, 120_000)),
        (105, 90_000, 0, False),  # a step is more than a tenth of a second
        (120, 300_000, 60_000, True),  # less than a quarter of the step
        (120, 300_000, 90_000, False),  # more
        (120, 2_000_000, 90_000, True),  # less than 0.1 s
        (120, 2_000_000, 150_000, False),  # more, though a small part of the step
        # a quarter of a second of uneven lateness is no stall
        (40, 200_000, 40_000, False),
        (40, 200_000, 100_000, False),
    ],
)
def test_latenesses_that_are_large_and_alike_show_a_step(count, step_us, spread_us, is_step):
    found_us = offset_us([step_us + (k % 2) * spread_us for k in range(count)])
    if is_step:  # to the promptest, and no further than the drift allows
        assert found_us == pytest.approx(2_000 + step_us, abs=1 if spread_us == 0 else 1_000)
    else:
        assert found_us < 2_000 + 0.1 * step_us


def busy_radio():
    """Nothing prompt for 10 s, in order, each 100 to 400 ms late or as late as the one before."""
    rng, arrivals_us = random.Random(1), [0]
    for k in range(500):
        arrivals_us.append(max(arrivals_us[-1], k * 20_000 + rng.randrange(100_000, 400_000)))
    return [arrival_us - k * 20_000 for k, arrival_us in enumerate(arrivals_us[1:])]


EVENLY = [302_000 + 4_000 * (k % 5) for k in range(14)]


@pytest.mark.parametrize(
    ("latenesses_us", "expected_us", "within_us"),
    [
        (busy_radio(), 0.0, MAX_DRIFT * 10_400_000),
        ([3_000_000 - 20_000 * k for k in range(150)], 0.0, 10_000),  # all of 3 s come at once
        # as far as the drift allows and never above what is seen, to the promptest of a step
        ([80_000] * 500, MAX_DRIFT * 10_000_000, 300),
        ([80_000] * 1500, 80_000, 0.1),
        ([500_000 + (k % 3) * 20_000 for k in range(120)], 500_000, 290),  # measured 240
        ([110_000 if k % 3 else 95_000 for k in range(120)], 0.0, MAX_DRIFT * 2_600_000),
        # a vehicle's clock that stands still is followed after a quarter of a second
        ([300_000 + 500 * (k % 3) for k in range(17)], 300_000, 150),
        (EVENLY[:-1], 0.0, 10_000),
        (EVENLY, 302_000, 0.1),  # to the least
    ],
)
def test_the_offset_after_messages_that_are_late(latenesses_us, expected_us, within_us):
    assert offset_us(latenesses_us) - 2_000 == pytest.approx(expected_us, abs=within_us)


def test_a_host_clock_set_back_does_not_lower_the_bound_twice():
    """Arrivals before the last one: the bound does not fall with negative time."""
    before_us = -200_000_000  # the first one
    clock = clock_after((0, OFFSET_US), (before_us, OFFSET_US + before_us + 100))
    assert clock.offset_us == OFFSET_US
    for time_us in (1_000_000, 1_010_000):
        clock.observe(time_us, OFFSET_US + time_us - 600_000_000)
    assert clock.offset_us == pytest.approx(OFFSET_US - 600_000_000, abs=1)


@pytest.mark.parametrize(
    ("median_us", "late_us", "is_held"),
    [(20_000.0, 300_000, True), (500_000.0, 300_000, False), (20_000.0, 90_000, False)],
)
def test_what_counts_as_held_back_follows_the_streams_interval(median_us, late_us, is_held):
    """Less than a tenth of a second is jitter in any stream."""
    clock = clock_after(*((k * 500_000, 50_000_000 + k * 500_000) for k in range(10)))
    taken_us = 5_000_000
    arrival_us = 55_000_000 + late_us
    time_us, age_us = clock.propagated_to(taken_us, arrival_us, median_us, arrival_us + 1000)
    if is_held:  # nobody knows whether that time has passed
        assert (time_us - taken_us, age_us) == (1000, pytest.approx(late_us + 1000, abs=20_000))
    else:
        assert (time_us - taken_us, age_us) == (pytest.approx(late_us + 1000, abs=20_000), 1000)


NUMBERS = ("error", "error_rate_1_s", "gain", "confidence_gravity", "confidence_magnetic")
VECTORS = ("q_ned_frd", "rate_rad_s", "gyro_bias_rad_s")


def recorded(state=State.RUNNING, age_us=0, **changes):
    turned = from_euler_rad(radians(10.0), radians(-20.0), radians(300.0))
    attitude = ATTITUDE._replace(**{"q_ned_frd": turned, **changes})
    times = {"time_unix_us": 1, "time_boot_us": 2, "age_us": age_us}
    return attitude_record(attitude, **times, state=state, sequence=3)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_any_number_that_is_not_finite_makes_no_record(bad):
    assert recorded() is not None
    for name in NUMBERS:
        assert recorded(**{name: bad}) is None, name
    for name in VECTORS:
        whole = getattr(ATTITUDE, name)
        for k in range(len(whole)):
            assert recorded(**{name: (*whole[:k], bad, *whole[k + 1 :])}) is None, (name, k)


def test_numbers_keep_their_places():
    made = recorded(state=State.DEGRADED, age_us=5_500)
    assert made.euler_deg == pytest.approx((10.0, -20.0, 300.0))
    assert (made.time_unix_us, made.time_boot_us, made.sequence) == (1, 2, 3)
    assert (made.state, made.age_ms) == ("degraded", 5.5)
    assert (made.error, made.error_rate, made.gain) == (0.01, 0.1, 3.0)
    assert (made.confidence.gravity, made.confidence.magnetic) == (1.0, 0.5)
    assert made.sigma_deg.inclination == pytest.approx(1.0)
    assert made.sigma_deg.heading == pytest.approx(5.0)
    made = recorded(sigma_heading_rad=inf, age_us=-3)  # half a turn; and no age is below zero
    assert (made.sigma_deg.heading, made.age_ms) == (180.0, 0.0)


@pytest.mark.parametrize("yaw_rad", [-1e-18, -1e-17, -6e-16, -8e-16, 0.0, pi, -pi, 2.0 * pi])
def test_yaw_is_below_360_degrees(yaw_rad):
    made = recorded(q_ned_frd=from_euler_rad(0.0, 0.0, yaw_rad))
    assert 0.0 <= made.euler_deg[2] < 360.0


MINUTES, RATE_HZ = 10, 50.0
LEVEL = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.81), (0.2, 0.0, 0.4))


def arrivals_us(sample_hz, seed):
    """Arrivals of a stream, up to 6 ms late and never in another order."""
    rng = np.random.default_rng(seed)
    times_us = np.arange(MINUTES * 60 * sample_hz) * 1e6 / sample_hz
    return np.maximum.accumulate(times_us + rng.uniform(0.0, 6_000.0, len(times_us))).astype(int)


def published(sample_hz, seed):
    """(host time, record, whether it leaves with a sample) of each; the host wakes when due."""
    pipeline, found = Pipeline(PAPER, rate_hz=RATE_HZ), []

    def note(outputs, now_us, is_with_sample):
        found.extend((now_us, record, is_with_sample) for record in attitudes(outputs))

    pipeline.tick(START_US)
    for k, arrival_us in enumerate(arrivals_us(sample_hz, seed).tolist()):
        now_us = START_US + arrival_us
        while k and pipeline.wake_us < now_us:
            woken_us = int(pipeline.wake_us) + 1
            note(pipeline.tick(woken_us), woken_us, False)
        sample = ImuSample(round(1e6 * k / sample_hz) + 1, *LEVEL, True)
        event = Imu(ONE, now_us, sample.time_us, "RAW_IMU", sample)
        note(pipeline.handle(event, now_us), now_us, True)
    return found


@pytest.mark.parametrize("sample_hz", [49.98, 50.0, 50.02, 100.0, 33.0, 10.0])
def test_as_many_leave_as_the_rate_asks_and_none_waits_for_the_grid(sample_hz):
    found = published(sample_hz, seed=3)
    assert [record.sequence for _, record, _ in found] == list(range(len(found)))
    found = [each for each in found if each[0] > START_US + 5_000_000]  # its rate is known then
    times_us, _, are_with_samples = map(np.array, zip(*found, strict=True))
    passed_s = 1e-6 * (times_us[-1] - times_us[0])
    assert len(found) - 1 == pytest.approx(RATE_HZ * passed_s, abs=1.6)
    assert np.diff(times_us).max() < 3.0e6 / RATE_HZ
    if sample_hz >= RATE_HZ - 0.1:
        assert np.mean(are_with_samples) > 0.98


def test_under_overload_the_rate_is_that_since_the_last_status():
    publishing, found = Publishing(RATE_HZ), []
    for second, count in enumerate((0, 20, 5)):
        for k in range(count):
            publishing.note_attitude(1_000_000 * second - 1_000 * (count - k), k)
        found.append(publishing.published_hz(1_000_000 * second, is_shedding=True))
    assert found == [RATE_HZ, 20.0, 5.0]


def test_an_attitude_is_no_repetition_once_the_hosts_clock_is_set_back():
    publishing = Publishing(50.0)
    publishing.note_attitude(100_000_000, 7)
    assert publishing.is_stale(100_000_000 + 1000, 7)
    assert not publishing.is_stale(40_000_000, 7)
    assert not publishing.is_stale(100_000_000 + 1000, 8)
