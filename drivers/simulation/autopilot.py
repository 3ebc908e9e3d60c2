"""A simulated vehicle's side of MAVLink, without sockets or clocks.

ATTITUDE and ATTITUDE_QUATERNION carry the truth, like SIM_STATE: the vehicle has no estimator with
errors of its own. A vehicle that flies sends position and velocity; those that turn on the spot
know of none. AUTOPILOT_VERSION shows that it is fuzzbee's own, and its motion, ten times a second,
ahead of the sample, so that a listener knows from the start what signals these are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, remainder, tau
from typing import Any

import numpy as np

from drivers.events import VehicleId
from drivers.mavlink import constants as mav
from drivers.mavlink import encoder
from drivers.mavlink.ardupilot import COMPASS_DECLINATION, COMPASS_OFFSETS, ORIENTATION, TRIM
from drivers.mavlink.decoder import BUILT_IN
from drivers.mavlink.encoder import FrameEncoder, Message, heartbeat
from drivers.simulation import simulated_vehicle
from drivers.simulation.flight import geodetic
from drivers.simulation.simulated_vehicle import Motion, Sample, SimulatedVehicle
from estimator.errors import InputError
from estimator.geometry.frames import euler_rad
from estimator.types import ZERO_VEC3, Quaternion, Vec3

HEARTBEAT_US = 1_000_000
SLOW_US = 100_000.0  # position and version
SLOW = (mav.AUTOPILOT_VERSION_ID, mav.GLOBAL_POSITION_INT_ID)
# What goes with samples, in the order on the wire; SIM_STATE has the time of its RAW_IMU
MESSAGES = (
    *(mav.AUTOPILOT_VERSION_ID, mav.RAW_IMU_ID, mav.SIM_STATE_ID, mav.ATTITUDE_ID),
    *(mav.ATTITUDE_QUATERNION_ID, mav.GLOBAL_POSITION_INT_ID),
)
FASTEST_RATE_HZ = 1000.0  # an interval below 1 ms is refused

# What a parameter list of a calibrated copter has about its IMU
PARAMETERS: tuple[tuple[str, float], ...] = (
    *((name, 0.0) for name in TRIM),
    (ORIENTATION, 0.0),
    *zip(COMPASS_OFFSETS, (5.0, -5.0, 5.0), strict=True),
    (COMPASS_DECLINATION, 0.0),
)


@dataclass(frozen=True, slots=True)
class VehicleOptions:
    """How the vehicles behave. Vehicle i has system id i and noise seed ``seed`` + i - 1."""

    seed: int = 0
    rate_hz: float = 100.0
    motion: Motion = "paper"
    noise: float = 1.0
    bias: float = 1.0
    magnet: tuple[float, float] | None = None  # s
    drop: float = 0.0  # probability that a frame is lost
    calm: bool = False  # a flight without its magnet and its silence
    errors_seed: int | None = None  # of its sensors' constant errors; + i - 1
    signing_key: bytes | None = None  # 32 bytes

    def vehicle(self, system_id: int) -> SimulatedVehicle:
        """The vehicle of that number.

        Raises:
            InputError: an option is out of its range.
        """
        if not 0.0 <= self.drop <= 1.0:
            raise InputError(f"the drop probability must be 0 to 1, not {self.drop}")
        if not (isfinite(self.rate_hz) and 0 < self.rate_hz <= FASTEST_RATE_HZ):
            raise InputError(
                f"the rate must be above 0 and up to {FASTEST_RATE_HZ:g} Hz, not {self.rate_hz:g}"
            )
        number, errors_seed = system_id - 1, self.errors_seed
        seeds = self.seed + number, None if errors_seed is None else errors_seed + number
        signals = (self.rate_hz, self.motion, self.noise, self.bias, self.magnet)
        return SimulatedVehicle(seeds[0], *signals, calm=self.calm, errors_seed=seeds[1])


class Schedule:
    """One message's stream; ``interval_us`` 0 means that it is off, and never due."""

    def __init__(self, default_us: float) -> None:
        self.default_us = self.interval_us = default_us
        self.due_us = 0.0

    def is_due(self, now_us: int) -> bool:
        """Whether to send with the sample at ``now_us``; moves on to the next time if so."""
        if now_us < self.due_us - 1:
            return False
        following_us = self.due_us + self.interval_us
        self.due_us = following_us if following_us > now_us else now_us + self.interval_us
        return True


class SimulatedAutopilot:
    """One vehicle's side of MAVLink: samples to frames, commands to answers. No I/O, no clock.

    Raises:
        InputError: an option is out of its range.
    """

    def __init__(
        self,
        options: VehicleOptions,
        system_id: int,
        component_id: int = mav.MAV_COMP_ID_AUTOPILOT1,
    ) -> None:
        self.id = VehicleId(system_id, component_id)
        self._options, self._vehicle = options, options.vehicle(system_id)
        self._encoder = FrameEncoder(self.id, options.signing_key)
        self._losses = np.random.default_rng([options.seed, system_id])
        self._receiver = np.random.default_rng([options.seed, system_id, 1])
        self._sample_us = self._default_us = 1e6 / options.rate_hz
        slow_us = max(SLOW_US, self._default_us)
        self._streams: dict[float, Schedule] = {
            each: Schedule(slow_us if each in SLOW else self._default_us)
            for each in MESSAGES
            if self._vehicle.knows_place or each != mav.GLOBAL_POSITION_INT_ID
        }
        self._heartbeat = Schedule(HEARTBEAT_US)
        self._answers: dict[str, Callable[[Any], list[Message]]] = {
            "COMMAND_LONG": self._command,
            "PARAM_REQUEST_LIST": lambda _: _parameters(),
            "PARAM_REQUEST_READ": _parameter_read,
        }
        self._next = next(self._vehicle)

    @property
    def due_us(self) -> float:
        """The boot time at which something is to be sent next."""
        return min(self._next.time_us, self._heartbeat.due_us)

    def advance(self, boot_us: float, unix_us: int) -> bytes:
        """Every frame due at ``boot_us``, in order; ``unix_us`` is the time for signatures."""
        messages: list[Message] = []
        while self.due_us <= boot_us:
            now_us = round(self.due_us)
            due: list[Message] = []
            if self._heartbeat.is_due(now_us):
                due.append(heartbeat(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA))
            if (sample := self._next).time_us <= now_us:
                numbers = [n for n, each in self._streams.items() if each.is_due(sample.time_us)]
                if mav.RAW_IMU_ID not in numbers and mav.SIM_STATE_ID in numbers:
                    numbers.remove(mav.SIM_STATE_ID)
                due += [self._message(number, sample) for number in numbers]
                self._next = next(self._vehicle)
            if not self._vehicle.is_silent(now_us):
                messages += due
        return self._frames(messages, unix_us)

    def skip(self, boot_us: float) -> None:
        """Let the time up to ``boot_us`` pass without sending."""
        while self._next.time_us < boot_us:
            self._next = next(self._vehicle)
        self._heartbeat.due_us = max(self._heartbeat.due_us, boot_us)

    def handle(self, message: Any, unix_us: int) -> bytes:
        """The answer to a message from outside, as frames; nothing if it is for others."""
        answer = self._answers.get(message.get_type())
        if answer is None or message.target_system not in (0, self.id.system_id):
            return b""
        if message.target_component not in (0, self.id.component_id):
            return b""
        return self._frames(answer(message), unix_us)

    def _message(self, number: float, s: Sample) -> Message:
        match number:
            case mav.AUTOPILOT_VERSION_ID:
                return encoder.autopilot_version(BUILT_IN, self._vehicle.motion)
            case mav.RAW_IMU_ID:
                return encoder.raw_imu(s.time_us, s.acc_m_s2, s.gyr_rad_s, s.mag_gauss)
            case mav.SIM_STATE_ID:
                q, motion = s.q_ned_frd, (s.true_force_m_s2, s.true_rate_rad_s)
                place = geodetic(s.position_ned_m) if self._vehicle.knows_place else ZERO_VEC3
                return encoder.sim_state(q, _euler(q), *motion, place, s.velocity_ned_m_s)
            case mav.ATTITUDE_ID:
                return encoder.attitude(s.time_us, _euler(s.q_ned_frd), s.true_rate_rad_s)
            case mav.ATTITUDE_QUATERNION_ID:
                return encoder.attitude_quaternion(s.time_us, s.q_ned_frd, s.true_rate_rad_s)
            case _:
                velocity = velocity_reported(s, self._options.noise, self._receiver)
                place, height_m = geodetic(s.position_ned_m), -s.position_ned_m[2]
                return encoder.global_position(s.time_us, place, height_m, velocity)

    def _frames(self, messages: list[Message], unix_us: int) -> bytes:
        frames, drop = [self._encoder.frame(each, unix_us) for each in messages], self._options.drop
        if drop > 0.0:
            frames = [frame for frame in frames if self._losses.random() >= drop]
        return b"".join(frames)

    def _command(self, message: Any) -> list[Message]:
        result = mav.MAV_RESULT_UNSUPPORTED
        if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            result = self._set_interval(message.param1, message.param2)
        sender = VehicleId(message.get_srcSystem(), message.get_srcComponent())
        return [encoder.command_ack(sender, message.command, result)]

    def _set_interval(self, message_id: float, interval_us: float) -> int:
        """MAVLink's rule: -1 turns a message off, 0 restores its default.

        The vehicle samples as fast as its fastest stream; without any, as at the start.
        """
        stream = {mav.HEARTBEAT_ID: self._heartbeat, **self._streams}.get(message_id)
        if stream is None:
            return mav.MAV_RESULT_FAILED
        interval_us = {-1.0: 0.0, 0.0: stream.default_us}.get(interval_us, interval_us)
        if not (interval_us == 0.0 or 1e6 / FASTEST_RATE_HZ <= interval_us < inf):
            return mav.MAV_RESULT_DENIED
        stream.interval_us, stream.due_us = interval_us, self._next.time_us if interval_us else inf
        wanted = [s.interval_us for s in self._streams.values() if s.interval_us]
        before_us, self._sample_us = self._sample_us, min(wanted, default=self._default_us)
        if self._sample_us != before_us:
            self._vehicle.change_rate(1e6 / self._sample_us)
        return mav.MAV_RESULT_ACCEPTED


def _parameters() -> list[Message]:
    numbered = enumerate(PARAMETERS)
    return [encoder.param_value(*parameter, len(PARAMETERS), k) for k, parameter in numbered]


def _parameter_read(message: Any) -> list[Message]:
    """By its number, or by its name where that is negative; nothing if there is none."""
    by_name = [k for k, (name, _) in enumerate(PARAMETERS) if name == message.param_id]
    found = by_name if message.param_index < 0 else [message.param_index]
    return [_parameters()[k] for k in found if k < len(PARAMETERS)]


def _euler(q: Quaternion) -> Vec3:
    """Roll, pitch, yaw (rad), the latter from -pi to pi."""
    roll, pitch, yaw = euler_rad(q)
    return (roll, pitch, remainder(yaw, tau))


def velocity_reported(sample: Sample, noise: float, generator: np.random.Generator) -> Vec3:
    """The velocity (m/s, NED) as a vehicle that flies shows it."""
    sigma_m_s = noise * simulated_vehicle.FLIGHT_VELOCITY_NOISE_M_S
    errors = sigma_m_s * generator.standard_normal(3)
    north, east, down = (sample.velocity_ned_m_s + errors).tolist()
    return (north, east, down)
