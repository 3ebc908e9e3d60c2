"""From the vehicle's clock to the host's.

A message that left at vehicle time t arrives at t + offset + latency with
latency >= 0, so the smallest (arrival - t) seen is the best bound of the
offset. The two clocks drift apart: an autopilot's clock was measured 44 to
136 ms a minute slow under load. The bound therefore rises slowly with time,
a little faster than that drift, and every prompt message pulls it down again.

A host clock that is set forwards (or a vehicle's, backwards) makes every message late by
the same amount from then on. Messages that were held back come with less and less delay
instead, so a second of late messages with one lateness is a step, and the bound follows it. So is a
quarter of a second of messages that come as evenly as the vehicle has stamped them: an
autopilot's clock that stands still under load is heard of at once.
"""

from typing import NamedTuple

MAX_DRIFT = 3e-3  # s/s; 136 ms a minute is 2.3e-3
STEP_US = 100_000  # less counts as lateness; time services set a clock that is 128 ms off or more
STEP_SPREAD_US = 100_000  # the latenesses that show a step differ by this at most
STEP_SPREAD = 0.25  # and at most that part of the step
WINDOW_US = 1_000_000
WINDOW_SAMPLES = 3  # a window of fewer shows nothing
EVEN_US = 250_000  # evenly late messages for this long show a step, too
EVEN_SPREAD_US = 30_000  # they count as evenly late while they differ by this at most
EVEN_SAMPLES = 6
# A sample later than so many periods (and than STEP_US) is not made up for.
HELD_PERIODS = 2


class Offsets(NamedTuple):
    """Least and most offset (host minus vehicle) since ``begin_us`` of the vehicle's clock."""

    begin_us: int
    least_us: float
    most_us: float
    samples: int = 1


class HostClock(NamedTuple):
    """Offset (host minus vehicle) at host time ``at_us``; ``known`` from the first message on."""

    offset_us: float = 0.0
    at_us: int = 0
    known: bool = False
    window: Offsets = Offsets(0, 0.0, 0.0)  # the offsets of the current second
    even: Offsets = Offsets(0, 0.0, 0.0)  # the offsets since two last differed by EVEN_SPREAD_US


def observe(clock: HostClock, vehicle_us: int, arrival_us: int) -> HostClock:
    """The clock after a message of ``vehicle_us`` arrived at ``arrival_us``."""
    seen_us = float(arrival_us - vehicle_us)
    if not clock.known:
        fresh = Offsets(vehicle_us, seen_us, seen_us, 1)
        return HostClock(seen_us, arrival_us, True, fresh, fresh)
    offset_us = min(_bound_us(clock, arrival_us), seen_us)
    even = _lengthen(clock.even, seen_us)
    if even.most_us - even.least_us > EVEN_SPREAD_US:
        even = Offsets(vehicle_us, seen_us, seen_us, 1)
    elif even.least_us - offset_us > STEP_US and _is_even(even, vehicle_us):
        offset_us = even.least_us
    window = clock.window
    if vehicle_us - window.begin_us >= WINDOW_US:
        offset_us = _moved_offset_us(window, offset_us)
        window = Offsets(vehicle_us, seen_us, seen_us, 1)
    else:
        window = _lengthen(window, seen_us)
    return HostClock(offset_us, arrival_us, True, window, even)


def to_vehicle_us(clock: HostClock, host_us: int) -> int:
    """The vehicle's time at host time ``host_us``; needs a known clock."""
    assert clock.known
    return round(host_us - clock.offset_us)


def propagated_to(
    clock: HostClock, taken_us: int, arrival_us: int, median_us: float, now_us: int
) -> tuple[int, int]:
    """The vehicle's time to publish at ``now_us``, and how old its last sample is then (us).

    The sample was of ``taken_us`` and arrived at ``arrival_us``; ``median_us`` is the interval of
    samples. If it came so late that the vehicle's clock may have stood still, the attitude is not
    propagated by that time: nobody knows whether it has passed.
    """
    since_us = now_us - arrival_us
    late_us = round(lateness_us(clock, taken_us, arrival_us))
    if late_us <= max(STEP_US, HELD_PERIODS * median_us):
        late_us = 0
    time_us = taken_us + since_us if late_us > 0 else to_vehicle_us(clock, now_us)
    return max(taken_us, time_us), since_us + late_us


def lateness_us(clock: HostClock, vehicle_us: int, arrival_us: int) -> float:
    """How much later a message came than prompt ones do; needs a known clock."""
    assert clock.known
    return arrival_us - vehicle_us - clock.offset_us


def _lengthen(window: Offsets, seen_us: float) -> Offsets:
    """The window with one more offset in it."""
    least_us, most_us = window.least_us, window.most_us
    if seen_us < least_us:
        least_us = seen_us
    elif seen_us > most_us:
        most_us = seen_us
    return Offsets(window.begin_us, least_us, most_us, window.samples + 1)


def _is_even(even: Offsets, vehicle_us: int) -> bool:
    """Whether messages have come with one lateness for a while."""
    return vehicle_us - even.begin_us >= EVEN_US and even.samples >= EVEN_SAMPLES


def _moved_offset_us(window: Offsets, offset_us: float) -> float:
    """The offset, moved if the window shows that the host's clock was set forwards."""
    step_us = window.least_us - offset_us
    is_step = (
        window.samples >= WINDOW_SAMPLES
        and step_us > STEP_US
        and window.most_us - window.least_us < min(STEP_SPREAD_US, STEP_SPREAD * step_us)
    )
    return window.least_us if is_step else offset_us


def _bound_us(clock: HostClock, now_us: int) -> float:
    return clock.offset_us + MAX_DRIFT * max(0, now_us - clock.at_us)
