"""Attitudes of others: rotations where they are any, in the time of the sample they belong to."""

import math
from typing import Literal

from drivers.events import Event, ReferenceAttitude, VehicleId
from estimator.geometry.frames import from_euler_rad
from estimator.types import Quaternion

UNIT_NORM_TOLERANCE = 0.05  # quaternions further from unit length are not attitudes
SAME_BURST_US = 2_000  # messages that are sent together arrive together
MOST_WAITING = 16

Source = Literal["autopilot", "sim"]


def quaternion_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion | None:
    """q_ned_frd of aerospace angles (yaw, then pitch, then roll), or None if one is not finite."""
    if not (math.isfinite(roll_rad) and math.isfinite(pitch_rad) and math.isfinite(yaw_rad)):
        return None
    return from_euler_rad(roll_rad, pitch_rad, yaw_rad)


def unit_or_none(q: Quaternion) -> Quaternion | None:
    """``q`` at unit length, or None if it is not close to that already (or not finite)."""
    w, x, y, z = q
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    if not abs(norm - 1.0) <= UNIT_NORM_TOLERANCE:  # also refuses NaN
        return None
    return (w / norm, x / norm, y / norm, z / norm)


class UnstampedAttitudes:
    """Gives each the time of the IMU message before it.

    A simulator's may as well have been sent right before its IMU message: unless it comes right
    behind one, it waits for the next, and belongs to that if both come together. A second one of
    the same IMU message is left out: its own was lost.
    """

    def __init__(self, vehicle: VehicleId) -> None:
        self._vehicle = vehicle
        self._last: tuple[int, int] | None = None  # time and arrival of the latest IMU sample
        self._waiting: list[tuple[str, int, Quaternion]] = []
        self._given_us: dict[str, int] = {}  # the time that each message has had last

    def imu(self, time_us: int, arrival_us: int) -> list[Event]:
        """A sample has come; the attitudes that have waited for it."""
        before_us, _ = (time_us, 0) if self._last is None else self._last
        events: list[Event] = []
        for name, heard_us, q_ned_frd in self._waiting:
            is_next = abs(arrival_us - heard_us) <= SAME_BURST_US
            events += self._at(time_us if is_next else before_us, name, heard_us, "sim", q_ned_frd)
        self._waiting.clear()
        self._last = time_us, arrival_us
        return events

    def end(self) -> list[Event]:
        """No sample comes any more; the attitudes that have waited belong to the last."""
        return [] if self._last is None else self.imu(*self._last)

    def attitude(
        self, name: str, arrival_us: int, source: Source, q_ned_frd: Quaternion
    ) -> list[Event]:
        """An attitude has come; nothing if it has to wait, or belongs to no sample."""
        if self._last is None:
            return []
        time_us, heard_us = self._last
        if source == "autopilot" or arrival_us - heard_us <= SAME_BURST_US:
            return self._at(time_us, name, arrival_us, source, q_ned_frd)
        if len(self._waiting) < MOST_WAITING:
            self._waiting.append((name, arrival_us, q_ned_frd))
        return []

    def _at(
        self, time_us: int, name: str, arrival_us: int, source: Source, q_ned_frd: Quaternion
    ) -> list[Event]:
        if self._given_us.get(name, time_us - 1) >= time_us:
            return []
        self._given_us[name] = time_us
        return [ReferenceAttitude(self._vehicle, arrival_us, time_us, source, name, q_ned_frd)]
