"""``sim:``, the built-in vehicle in process: its exact numbers in real time."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Self

import numpy as np

from drivers.closing import Closing
from drivers.events import (
    BuiltIn,
    Event,
    Heartbeat,
    Imu,
    LinkUp,
    Parameter,
    Position,
    ReferenceAttitude,
    VehicleId,
    Velocity,
)
from drivers.mavlink import constants as mav
from drivers.samples.fix import Fix, velocity_sample
from drivers.simulation.autopilot import HEARTBEAT_US, PARAMETERS, SLOW_US, velocity_told
from drivers.simulation.flight import geodetic
from drivers.simulation.simulated_vehicle import Sample, SimulatedVehicle
from estimator.types import ImuSample

# Where the service cannot keep up, or the computer slept, the flight waits rather than falls
# silent: an overloaded computer must not look like an estimator that fails.
MOST_BEHIND_US = 100_000


class SimSource(Closing):
    """The simulated vehicle as a live source, paced by the host's clock.

    A sample is there from the moment its time has come, with exactly that time as its arrival. It
    has a clock of its own, ``now_us``, which waits for whoever drains too slowly: nothing is
    dropped. ``monotonic_us`` and ``unix_us`` are the host's clocks.
    """

    shed = lost = dropped = 0

    def __init__(
        self,
        vehicle: SimulatedVehicle,
        monotonic_us: Callable[[], int] = lambda: time.monotonic_ns() // 1000,
        unix_us: Callable[[], int] = lambda: time.time_ns() // 1000,
    ) -> None:
        self._vehicle = vehicle
        self._id = VehicleId(1, mav.MAV_COMP_ID_AUTOPILOT1)
        self._monotonic_us = monotonic_us
        self._unix_us = unix_us
        self._closed = threading.Event()
        self._next = next(vehicle)
        self._heartbeat_due_us = 0
        self._place_due_us = 0.0
        self._receiver = np.random.default_rng([0, 1, 1])
        self._start_us = 0
        self._start_unix_us = 0
        self._waited_us = 0
        self._announced = False

    def __enter__(self) -> Self:
        self._start_us = self._monotonic_us()
        self._start_unix_us = self._unix_us()
        return self

    def close(self) -> None:
        """End any waiting; nothing comes any more."""
        self._closed.set()

    def drain(self, timeout_s: float) -> list[Event]:
        """All events whose time has come, after waiting at most ``timeout_s`` for the first."""
        if self._closed.is_set():
            return []
        if not self._announced:
            self._announced = True
            return [LinkUp(self._start_unix_us, f"sim:{self._vehicle.motion}"), *self._due_events()]
        events = self._due_events()
        if not events and timeout_s > 0:
            wait_s = (self._next.time_us - self._now_us()) * 1e-6
            if not self._closed.wait(min(timeout_s, max(0.0, wait_s))):
                events = self._due_events()
        return events

    def now_us(self) -> int:
        """The Unix time of the simulation: the host's, but for what it has waited."""
        return self._start_unix_us + self._now_us()

    @property
    def flown_s(self) -> float:
        """How long the vehicle has moved."""
        return 1e-6 * self._now_us()

    @property
    def waited_s(self) -> float:
        """How long it has waited for the service."""
        return 1e-6 * self._waited_us

    def _now_us(self) -> int:
        """The time since the start, which does not run away from what nobody has drained."""
        running_us = self._monotonic_us() - self._start_us - self._waited_us
        return min(running_us, self._next.time_us + MOST_BEHIND_US)

    def _due_events(self) -> list[Event]:
        now_us = self._now_us()
        self._waited_us = self._monotonic_us() - self._start_us - now_us
        events: list[Event] = []
        while self._next.time_us <= now_us:
            if not self._vehicle.is_silent(self._next.time_us):
                events += self._events(self._next)
            self._next = next(self._vehicle)
        return events

    def _events(self, sample: Sample) -> Iterator[Event]:
        arrival_us = self._start_unix_us + sample.time_us
        if sample.time_us >= self._heartbeat_due_us:
            self._heartbeat_due_us = sample.time_us + HEARTBEAT_US
            yield Heartbeat(
                self._id, arrival_us, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mav.MAV_TYPE_QUADROTOR
            )
            yield BuiltIn(self._id, arrival_us, self._vehicle.motion)
            for name, value in PARAMETERS:
                yield Parameter(self._id, arrival_us, name, value)
        yield Imu(self._id, arrival_us, sample.time_us, "RAW_IMU", imu_sample(sample))
        yield ReferenceAttitude(
            self._id, arrival_us, sample.time_us, "sim", "SIM_STATE", sample.q_ned_frd
        )
        if self._vehicle.tells_place and sample.time_us >= self._place_due_us:
            self._place_due_us = sample.time_us + SLOW_US
            yield from self._place(sample, arrival_us)

    def _place(self, sample: Sample, arrival_us: int) -> Iterator[Event]:
        name, time_us = "GLOBAL_POSITION_INT", sample.time_us
        place = geodetic(sample.position_ned_m)
        yield Position(self._id, arrival_us, time_us, name, *place)
        fix = Fix(velocity_told(sample, 1.0, self._receiver))
        velocity = velocity_sample(name, fix, time_us)
        if velocity is not None:
            yield Velocity(self._id, arrival_us, name, velocity)


def imu_sample(sample: Sample) -> ImuSample:
    """The measured part of a simulated sample."""
    return ImuSample(
        sample.time_us, sample.gyr_rad_s, sample.acc_m_s2, sample.mag_gauss, has_mag=True
    )
