"""The part of a log between two times, or from arming to disarming."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from drivers import events
from drivers.events import Event, Heartbeat, ModeChange, VehicleEvent, VehicleId

# Seconds since the vehicle's first IMU sample, or when it was armed or disarmed.
Moment = float | Literal["arm", "disarm"]
# What is left out before and after the window. Parameters, heartbeats and the like describe the
# vehicle at any time.
MEASURED = (
    *(events.Imu, events.ReferenceAttitude, events.Report, events.Position),
    *(events.ClockReset, events.TrackLost, events.Rejected, events.Shed),
)


class TimeWindow(NamedTuple):
    """The wanted part of a log; None stands for its beginning or its end."""

    begin: Moment | None = None
    end: Moment | None = None


WHOLE_LOG = TimeWindow()


@dataclass(slots=True)
class _Progress:
    """How far one vehicle's part of the log has come."""

    zero_us: int | None = None  # time of the first IMU sample
    last_us: int = 0
    is_armed: bool | None = None  # None: no message has reported it yet
    phase: Literal["before", "open", "over"] = "before"


class WindowedEvents:
    """The events of a log with the measurements outside ``window`` left out, vehicle by vehicle.

    The window of a vehicle opens once. Where its end never comes it lasts to the end of the log.
    """

    def __init__(self, events: Iterable[Event], window: TimeWindow) -> None:
        self._events = events
        self._window = window
        self._vehicles: dict[VehicleId, _Progress] = {}

    def __iter__(self) -> Iterator[Event]:
        for event in self._events:
            if not isinstance(event, VehicleEvent):
                yield event
                continue
            progress = self._vehicles.setdefault(event.vehicle, _Progress())
            if isinstance(event, Heartbeat | ModeChange) and event.is_armed is not None:
                self._arm(progress, event.is_armed)
            elif isinstance(event, events.Imu):
                self._advance(progress, event.sample.time_us)
            if progress.phase == "open" or not isinstance(event, MEASURED):
                yield event

    def zero_us(self, vehicle: VehicleId) -> int | None:
        """The time that the seconds of the window count from; None without an IMU sample."""
        progress = self._vehicles.get(vehicle)
        return None if progress is None else progress.zero_us

    def why_empty(self) -> str | None:
        """Why no vehicle's window has opened; None if one has, or none had IMU samples."""
        flown = [each for each in self._vehicles.values() if each.zero_us is not None]
        if not flown or any(each.phase != "before" for each in flown):
            return None
        begin = self._window.begin
        if isinstance(begin, float):
            lasts_s = max(1e-6 * (each.last_us - (each.zero_us or 0)) for each in flown)
            return f"no IMU data from {begin:g} s on: the log lasts {lasts_s:.1f} s"
        if all(each.is_armed is None for each in self._vehicles.values()):
            return "the log does not report when the vehicle was armed"
        return f"the vehicle was never {begin}ed"

    def _arm(self, progress: _Progress, is_armed: bool) -> None:
        """Open or close at a change; a log may begin with a vehicle that is armed already."""
        before, progress.is_armed = progress.is_armed, is_armed
        if is_armed == bool(before):
            return
        moment = "arm" if is_armed else "disarm"
        if progress.phase == "open" and self._window.end == moment and before is not None:
            progress.phase = "over"
        elif progress.phase == "before" and self._window.begin == moment:
            progress.phase = "open"

    def _advance(self, progress: _Progress, time_us: int) -> None:
        """Open or close by time."""
        if progress.zero_us is None:
            progress.zero_us = time_us
        progress.last_us = time_us
        since_s = 1e-6 * (time_us - progress.zero_us)
        begin, end = self._window
        is_begun = not isinstance(begin, str) and since_s >= (begin or 0.0)
        if progress.phase == "before" and is_begun:
            progress.phase = "open"
        if progress.phase == "open" and isinstance(end, float) and since_s > end:
            progress.phase = "over"
