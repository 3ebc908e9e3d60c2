"""From the vehicle's clock to the host's.

A message that left at vehicle time t arrives at t + offset + latency with
latency >= 0, so the smallest (arrival - t) seen is the best bound of the
offset. The two clocks drift apart: an autopilot's clock was measured 44 to
136 ms a minute slow under load. The bound therefore rises slowly with time,
a little faster than that drift, and every prompt message pulls it down again.
"""

from typing import NamedTuple

MAX_DRIFT = 3e-3  # s/s; 136 ms a minute is 2.3e-3


class HostClock(NamedTuple):
    """Offset (host minus vehicle) as it was at ``at_us``, host time; empty before the first."""

    offset_us: float = 0.0
    at_us: int = 0
    known: bool = False


def observe(clock: HostClock, vehicle_us: int, arrival_us: int) -> HostClock:
    """The clock after a message of ``vehicle_us`` arrived at ``arrival_us``."""
    seen_us = float(arrival_us - vehicle_us)
    if not clock.known:
        return HostClock(seen_us, arrival_us, known=True)
    return HostClock(min(_bound_us(clock, arrival_us), seen_us), arrival_us, known=True)


def to_vehicle_us(clock: HostClock, host_us: int) -> int:
    """The vehicle's time at host time ``host_us``; needs a known clock."""
    assert clock.known
    return round(host_us - clock.offset_us)


def _bound_us(clock: HostClock, now_us: int) -> float:
    return clock.offset_us + MAX_DRIFT * max(0, now_us - clock.at_us)
