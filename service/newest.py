"""Of the events that wait, those that newer ones have not made old."""

from collections import Counter
from collections.abc import Iterable

from drivers.events import (
    BodyRates,
    Event,
    Imu,
    Position,
    ReferenceAttitude,
    Shed,
    VehicleId,
    Velocity,
)

_STREAMS = (Imu, BodyRates, Velocity, Position, ReferenceAttitude)


def newest_events(events: Iterable[Event]) -> list[Event]:
    """Of each vehicle's streams the newest event, and all other events, in order.

    The IMU samples that were left out come as :class:`~drivers.events.Shed` behind them.
    """
    seen: set[tuple[type, VehicleId, str]] = set()
    kept: list[Event] = []
    shed: Counter[tuple[VehicleId, str]] = Counter()
    arrival_us = 0
    for event in reversed(list(events)):
        if isinstance(event, _STREAMS):
            key = (event.__class__, event.vehicle, event.message)
            if key in seen:
                if isinstance(event, Imu):
                    shed[event.vehicle, event.message] += 1
                continue
            seen.add(key)
            arrival_us = max(arrival_us, event.arrival_us)
        kept.append(event)
    kept.reverse()
    kept += [Shed(vehicle, arrival_us, name, count) for (vehicle, name), count in shed.items()]
    return kept
