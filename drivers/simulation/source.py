"""``sim:``, the built-in vehicle in process: its exact numbers in real time."""

import time
from collections.abc import Callable, Iterator

import numpy as np

from drivers import events
from drivers.events import Event, VehicleId
from drivers.mavlink import constants as mav
from drivers.player import Player
from drivers.resources import Closing
from drivers.samples.navigation import Fix, velocity_sample
from drivers.simulation import autopilot
from drivers.simulation.autopilot import PARAMETERS, Schedule, velocity_reported
from drivers.simulation.flight import geodetic
from drivers.simulation.simulated_vehicle import SimulatedVehicle
from estimator.types import ImuSample


class SimSource(Player, Closing):
    """The simulated vehicle as a live source, paced by the host's clock.

    A sample is there from the moment its time has come, with exactly that time as its arrival.
    ``monotonic_us`` and ``unix_us`` are the host's clocks.
    """

    def __init__(
        self,
        vehicle: SimulatedVehicle,
        monotonic_us: Callable[[], int] = lambda: time.monotonic_ns() // 1000,
        unix_us: Callable[[], int] = lambda: time.time_ns() // 1000,
    ) -> None:
        self._vehicle = vehicle
        self._id = VehicleId(1, mav.MAV_COMP_ID_AUTOPILOT1)
        self._heartbeat, self._place = Schedule(autopilot.HEARTBEAT_US), Schedule(autopilot.SLOW_US)
        self._receiver = np.random.default_rng([0, 1, 1])
        self._start_unix_us = unix_us()
        super().__init__(self._flown(), 1.0, lambda: 1e-6 * monotonic_us())

    @property
    def flown_s(self) -> float:
        """How long the vehicle has moved."""
        return 1e-6 * (self.now_us() - self._start_unix_us)

    def close(self) -> None:
        """Nothing comes any more."""
        self._next = None

    def _flown(self) -> Iterator[Event]:
        """What the simulated autopilot shows by MAVLink, as exact events."""
        motion = self._vehicle.motion
        yield events.LinkUp(self._start_unix_us, f"sim:{motion}")
        for sample in self._vehicle:
            time_us, about = sample.time_us, (self._id, self._start_unix_us + sample.time_us)
            if self._vehicle.is_silent(time_us):
                continue
            if self._heartbeat.is_due(time_us):
                kind = mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mav.MAV_TYPE_QUADROTOR
                yield events.Heartbeat(*about, *kind)
                yield events.BuiltIn(*about, motion)
                yield from (events.Parameter(*about, name, value) for name, value in PARAMETERS)
            measured = ImuSample(*sample[:4], has_mag=True)
            yield events.Imu(*about, time_us, "RAW_IMU", measured)
            yield events.ReferenceAttitude(*about, time_us, "sim", "SIM_STATE", sample.q_ned_frd)
            if self._vehicle.knows_place and self._place.is_due(time_us):
                name = "GLOBAL_POSITION_INT"
                fix = Fix(velocity_reported(sample, 1.0, self._receiver))
                yield events.Position(*about, time_us, name, *geodetic(sample.position_ned_m))
                if (velocity := velocity_sample(name, fix, time_us)) is not None:
                    yield events.Velocity(*about, name, velocity)
