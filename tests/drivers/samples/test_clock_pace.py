"""A clock that keeps no time is refused; a link that is late is not taken for one."""

from itertools import pairwise

import pytest

from drivers.samples.vehicle_clock import Placed, TimeField, VehicleClock
from tests.drivers.mavlink.messages import UNIX, S

USEC, BOOT_MS = TimeField.TIME_USEC, TimeField.BOOT_MS
OFF = "clock_pace"


def given(clock, boot_s, arrival_s, field=USEC, message="RAW_IMU"):
    """What becomes of an IMU message, times in seconds."""
    unit_us = 1000 if field is BOOT_MS else 1
    raw_us = round(boot_s * S) // unit_us * unit_us
    return clock.place(message, field, raw_us, UNIX + round(arrival_s * S), is_imu=True)


def fed(rate_hz, seconds, boot_s=lambda s: s, arrival_s=lambda s: s, clock=None):
    """A steady stream; ``boot_s`` and ``arrival_s`` map true time to what the clocks show."""
    clock = VehicleClock() if clock is None else clock
    times_s = [k / rate_hz for k in range(round(seconds * rate_hz))]
    return [(s, given(clock, 5.0 + boot_s(s), arrival_s(s))) for s in times_s]


def at_pace(pace, since_s=30.0, until_s=1e9):
    """A clock that runs at another pace for a while."""
    return lambda s: s + (pace - 1.0) * (min(max(s, since_s), until_s) - since_s)


@pytest.mark.parametrize("rate_hz", [50.0, 4.0, 1.0])
@pytest.mark.parametrize(
    ("pace", "since_s"), [(1e-3, 0.0), (1e-3, 30.0), (0.1, 30.0), (10.0, 30.0)]
)
def test_a_clock_ten_times_too_fast_or_slow_is_refused_within_three_seconds(pace, since_s, rate_hz):
    """Also one of milliseconds for microseconds from the start."""
    placed = fed(rate_hz, since_s + 30.0, at_pace(pace, since_s))
    assert all(isinstance(p, Placed) for s, p in placed if s <= since_s)
    reasons = {p for s, p in placed if s > since_s + 3.0}
    assert reasons <= {OFF, *(["clock_step"] if pace > 1.0 else [])}
    is_steps = pace / rate_hz > 5.0  # such are refused one by one
    assert (OFF in reasons) != is_steps


@pytest.mark.parametrize("pace", [0.25, 0.9, 1.03, 4.0])
def test_a_log_played_at_another_speed_is_taken(pace):
    assert all(isinstance(p, Placed) for _, p in fed(50.0, 60.0, at_pace(pace)))


def held_back(for_s):
    """All of 30 s on comes at once, that late."""
    return lambda s: 30.0 + for_s if 30.0 <= s < 30.0 + for_s else s


def gaps_one_after_the_other(s):
    """As a radio link did it: two seconds' messages came behind the first gap."""
    return 32.5 if 30.0 < s <= 32.0 else 43.0 if 32.0 < s < 43.0 else s


ARRIVALS = {
    "held back for 14 s": held_back(14.0),
    "held back for 29 s": held_back(29.0),
    "14 s held back, then sent at seven times the stream's pace": (
        lambda s: s if s < 30.0 else max(44.0 + (s - 30.0) / 7.0, s)
    ),
    "stalled again and again": lambda s: s if s % 2.6 < 1.3 else s - s % 2.6 + 2.6,
    "gaps one after the other": gaps_one_after_the_other,
    "a session that begins with what was held back before": lambda s: max(s, 14.0),
    "set back": lambda s: s - 3600.0 * (s > 30.0),
    "set forwards": lambda s: s + 3600.0 * (s > 30.0),
    "set forwards by a day, and back": lambda s: s + 86_400.0 * (30.0 < s < 31.25),
}


@pytest.mark.parametrize("rate_hz", [50.0, 4.0])
@pytest.mark.parametrize("arrival_s", ARRIVALS.values(), ids=ARRIVALS)
def test_a_late_link_or_a_host_s_clock_that_is_set_costs_no_sample(arrival_s, rate_hz):
    placed = fed(rate_hz, 90.0, arrival_s=arrival_s)
    assert all(isinstance(p, Placed) and p.reset is None for _, p in placed)


@pytest.mark.parametrize(("pace", "lost_s"), [(1e-3, -20.0), (10.0, 180.0)])
def test_a_clock_that_keeps_time_again_begins_anew(pace, lost_s):
    """What passed meanwhile nobody knows: it is a jump, by the time that was lost or invented."""
    placed = fed(50.0, 80.0, at_pace(pace, 30.0, 50.0))
    (reset,) = (p.reset for _, p in placed if isinstance(p, Placed) and p.reset)
    assert reset.reason == "jump"
    assert reset.step_us == pytest.approx(lost_s * S, abs=0.1 * S)
    assert all(isinstance(p, Placed) for s, p in placed if s > 52.0)
    times_us = [p.time_us for _, p in placed if isinstance(p, Placed)]
    assert all(a < b for a, b in pairwise(times_us))


def test_a_reboot_ends_it_at_once():
    clock = VehicleClock()
    fed(4.0, 60.0, lambda s: 300.0 + 1e-3 * s, clock=clock)
    assert given(clock, 305.1, 60.0) == OFF
    waiting, taken = (given(clock, 2.0 + s, 60.5 + s) for s in (0.0, 0.25))
    assert waiting == "clock_step"
    assert taken.reset.reason == "reboot"


def test_where_one_clock_keeps_no_time_another_makes_the_line():
    clock, second = VehicleClock(), []
    for k in range(200):
        time_s = k / 10.0
        first = given(clock, 1e-3 * time_s, time_s)
        second.append(given(clock, 50.0 + time_s, time_s, BOOT_MS, "SCALED_IMU2"))
    assert first == OFF
    late = [p.time_us for p in second[40:]]
    assert [b - a for a, b in pairwise(late)] == [100_000] * 159
