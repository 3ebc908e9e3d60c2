"""A vehicle as its own log saw it: what DataFlash and ULog have in common.

Such a log knows no arrivals. Its own times, on Unix time where a GPS gave it, stand in for them.
"""

import math
from collections import defaultdict
from collections.abc import Iterable
from typing import Literal

from drivers.events import (
    ClockReset,
    Event,
    Imu,
    Notice,
    Position,
    ReferenceAttitude,
    Rejected,
    TrackLost,
    VehicleId,
    Velocity,
)
from drivers.logs.log_time import LogTime
from drivers.mavlink.decoder import GPS_LATE_SIGMA_S
from drivers.samples.fresh_field import FreshField
from drivers.samples.imu_checks import Plausibility, refuse_imu
from drivers.samples.navigation import Navigation
from drivers.samples.sensor_faults import Readings, SensorFaults
from drivers.samples.vehicle_clock import Placed, Refused, TimeField, VehicleClock
from estimator.types import ZERO_VEC3, Quaternion, Vec3, VelocitySample


class LoggedVehicle:
    """Judges and places one vehicle's readings. ``unix_us`` is Unix time minus the log's time.

    Readings may be numbers of any kind, as the log has them.

    Raises:
        TypeError, ValueError: what should be a number is none.
    """

    def __init__(self, vehicle: VehicleId, autopilot: int, unix_us: int) -> None:
        self.id = vehicle
        self._autopilot = autopilot
        self._unix_us = unix_us
        self.navigation = Navigation()
        self._clock = VehicleClock()
        self._log_time = LogTime()
        self._field = FreshField()
        self._mag_gauss = ZERO_VEC3
        self._faults: defaultdict[str, SensorFaults] = defaultdict(SensorFaults)
        self._plausibility: defaultdict[str, Plausibility] = defaultdict(Plausibility)

    def arrival_us(self, raw_us: int) -> int:
        """The log's time ``raw_us`` as a time of arrival."""
        return self._unix_us + raw_us

    def put_mag(self, mag_gauss: Vec3, raw_us: int) -> None:
        """Take a magnetic reading in, for the IMU samples behind it."""
        field = _floats(mag_gauss)
        self._mag_gauss = field if _all_finite(field) else ZERO_VEC3
        self._field.put(field, raw_us)

    def imu(
        self, stream: str, field: TimeField, raw_us: int, gyr_rad_s: Vec3, acc_m_s2: Vec3
    ) -> list[Event]:
        """The sample, with the magnetic field if that is new; or why it is none."""
        arrival_us = self.arrival_us(raw_us)
        gyr, acc = _floats(gyr_rad_s), _floats(acc_m_s2)
        refusal = refuse_imu(gyr, acc)
        if refusal is not None:
            return [Rejected(self.id, arrival_us, refusal, stream)]
        faults = self._faults[stream]
        refusal = faults.refusal(Readings(gyr, acc, self._mag_gauss), raw_us)
        if refusal is not None:
            return [Rejected(self.id, arrival_us, refusal, stream)]
        placed = self._clock.imu(stream, field, raw_us, self._log_time.arrival_us(raw_us))
        if isinstance(placed, Refused):
            return [Rejected(self.id, arrival_us, placed.reason, stream)]
        events = self._resets(placed, arrival_us)
        if (blindness := faults.take_blindness()) is not None:
            reason, span_us = blindness
            events.append(TrackLost(self.id, arrival_us, stream, reason, span_us * 1e-6))
        sample = self._field.sample(stream, raw_us, placed.time_us, gyr, acc)
        if sample.has_mag and faults.mag_is_stuck:
            sample = sample._replace(mag_gauss=ZERO_VEC3, has_mag=False)
            events.append(Rejected(self.id, arrival_us, "magnetometer_stuck", stream))
        complaints = self._plausibility[stream].look(sample, self._autopilot)
        return [
            *events,
            Imu(self.id, arrival_us, placed.boot_us, stream, sample),
            *(Notice(self.id, arrival_us, f"{stream}: {text}") for text in complaints),
        ]

    def reference(
        self,
        name: str,
        field: TimeField,
        raw_us: int,
        source: Literal["autopilot", "sim"],
        q_ned_frd: Quaternion | None,
    ) -> list[Event]:
        """Somebody's attitude; None for one that is no rotation."""
        placed = self._place(name, field, raw_us)
        if placed is None:
            return []
        arrival_us = self.arrival_us(raw_us)
        events = self._resets(placed, arrival_us)
        if q_ned_frd is not None:
            events.append(
                ReferenceAttitude(self.id, arrival_us, placed.time_us, source, name, q_ned_frd)
            )
        return events

    def fix(
        self,
        name: str,
        field: TimeField,
        raw_us: int,
        velocity: tuple[Vec3, bool, float],
        position: Vec3 | None = None,
    ) -> list[Event]:
        """A velocity and perhaps a position; either is left out where it is not finite.

        A velocity alone is a filter's, and believed as far as that believes itself.
        ``velocity`` is NED in m/s, whether its vertical part is one, and its sigma in m/s.
        ``position`` is latitude and longitude in degrees and altitude in m.
        """
        placed = self._place(name, field, raw_us)
        if placed is None:
            return []
        arrival_us, time_us = self.arrival_us(raw_us), placed.time_us
        events = self._resets(placed, arrival_us)
        if position is not None and _all_finite(position):
            events.append(Position(self.id, arrival_us, time_us, name, *_floats(position)))
        velocity_ned_m_s, has_vertical, own_sigma_m_s = velocity
        sigma_m_s: float | None = own_sigma_m_s
        if position is None:
            sigma_m_s = self.navigation.velocity_sigma_m_s(own_sigma_m_s, arrival_us)
        if sigma_m_s is not None and _all_finite((*velocity_ned_m_s, sigma_m_s)):
            late_s = 0.0 if position is None else GPS_LATE_SIGMA_S  # a receiver's, not a filter's
            sample = VelocitySample(
                time_us, _floats(velocity_ned_m_s), has_vertical, float(sigma_m_s), late_s
            )
            events.append(Velocity(self.id, arrival_us, name, sample))
        return events

    def _place(self, name: str, field: TimeField, raw_us: int) -> Placed | None:
        placed = self._clock.other(name, field, raw_us, self._log_time.arrival_us(raw_us))
        return None if isinstance(placed, Refused) else placed

    def _resets(self, placed: Placed, arrival_us: int) -> list[Event]:
        reset = placed.reset
        if reset is None:
            return []
        if reset.reason == "reboot":
            self.navigation.forget()
        return [ClockReset(self.id, arrival_us, reset.reason, reset.step_us * 1e-6)]


def _floats(vector: Vec3) -> Vec3:
    x, y, z = vector
    return (float(x), float(y), float(z))


def _all_finite(values: Iterable[float]) -> bool:
    return all(map(math.isfinite, values))
