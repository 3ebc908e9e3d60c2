"""MAVLink messages to events: units and who is who.

``MavlinkDecoder`` turns pymavlink's messages into the events of ``drivers.events``,
without any I/O. Units change here and nowhere else: mg, mrad/s, mGauss, cm/s and
degrees come in, SI, radians and gauss go out. Body axes are FRD on both sides.
"""

import math
import struct
from collections.abc import Callable
from typing import Any, Final

from drivers.events import (
    ClockReset,
    CommandAck,
    Event,
    Heartbeat,
    Imu,
    Notice,
    Parameter,
    Position,
    ReferenceAttitude,
    Rejected,
    TrackLost,
    VehicleId,
    Velocity,
)
from drivers.mavlink.constants import (
    GPS_FIX_TYPE_3D_FIX,
    HIGHRES_IMU_UPDATED_MAG,
    MAV_AUTOPILOT_PX4,
    MAV_PARAM_TYPE_INT8,
    MAV_PARAM_TYPE_INT16,
    MAV_PARAM_TYPE_INT32,
    MAV_PARAM_TYPE_UINT8,
    MAV_PARAM_TYPE_UINT16,
    MAV_PARAM_TYPE_UINT32,
    UNKNOWN_UINT16,
    is_autopilot,
)
from drivers.samples.imu_checks import MagMemory, Plausibility, refuse_imu
from drivers.samples.navigation import Navigation, filter_status
from drivers.samples.sensor_faults import Readings, SensorFaults
from drivers.samples.vehicle_clock import Placed, Refused, TimeField, VehicleClock
from drivers.value import Value
from estimator.geometry.frames import from_euler_rad
from estimator.types import (
    STANDARD_GRAVITY_M_S2,
    ZERO_VEC3,
    ImuSample,
    Quaternion,
    Vec3,
    VelocitySample,
)

MG_M_S2 = STANDARD_GRAVITY_M_S2 / 1000.0
MILLI = 1e-3

GAUSS_LIMIT = 20.0  # the Earth's field is 0.25..0.65 gauss; more is another unit
MILLIGAUSS_LIMIT = 20_000.0

FILTER_VELOCITY_SIGMA_M_S = 0.3  # an autopilot's own filter, typical with GPS
GPS_VELOCITY_SIGMA_M_S = 0.5  # a GPS receiver that does not say
GPS_LATE_SIGMA_S = 0.1  # its word comes 0.1 to 0.2 s late, and does not say how late

UNIT_NORM_TOLERANCE = 0.05  # quaternions further from unit length are not attitudes

MOST_SENDERS = 512  # addresses that something is remembered of: 11 kB each
MOST_STREAMS = 16  # IMUs of one sender; real ones have three, and four messages for them

CLOCK_STEP = Refused("clock_step")

INTEGER_PARAMETERS: Final = {  # and how struct calls them
    MAV_PARAM_TYPE_UINT8: "B",
    MAV_PARAM_TYPE_INT8: "b",
    MAV_PARAM_TYPE_UINT16: "H",
    MAV_PARAM_TYPE_INT16: "h",
    MAV_PARAM_TYPE_UINT32: "I",
    MAV_PARAM_TYPE_INT32: "i",
}


class _Reading(Value, frozen=True):
    """An IMU message in SI units, without its place in time."""

    arrival_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


class _ImuStream:
    """What the decoder remembers about one IMU message of one sender."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.mag = MagMemory()
        self.plausibility = Plausibility()
        self.faults = SensorFaults()
        self.held: _Reading | None = None


class _Vehicle:
    """What the decoder remembers about one sender."""

    def __init__(self, vehicle: VehicleId) -> None:
        self.id = vehicle
        self.autopilot: int | None = None
        self.clock = VehicleClock()
        self.imus: dict[str, _ImuStream] = {}
        self.last_imu_us: int | None = None
        self.truth_given_us: dict[str, int] = {}
        self.navigation = Navigation()

    def imu(self, name: str) -> _ImuStream | None:
        """The stream of that name, a new one if need be; None if there are too many."""
        stream = self.imus.get(name)
        if stream is None and len(self.imus) < MOST_STREAMS:
            stream = self.imus[name] = _ImuStream(name)
        return stream


class MavlinkDecoder:
    """pymavlink messages in, events out, for any number of vehicles."""

    def __init__(self) -> None:
        self._vehicles: dict[tuple[int, int], _Vehicle] = {}
        self._handlers: dict[str, Callable[[_Vehicle, Any, int], list[Event]]] = {
            "RAW_IMU": self._raw_imu,
            "SCALED_IMU": self._scaled_imu,
            "SCALED_IMU2": self._scaled_imu,
            "SCALED_IMU3": self._scaled_imu,
            "HIGHRES_IMU": self._highres_imu,
            "ATTITUDE": self._attitude,
            "ATTITUDE_QUATERNION": self._attitude_quaternion,
            "SIM_STATE": self._sim_state,
            "SIMSTATE": self._simstate,
            "GLOBAL_POSITION_INT": self._global_position,
            "LOCAL_POSITION_NED": self._local_position,
            "GPS_RAW_INT": self._gps_raw,
            "EKF_STATUS_REPORT": self._ekf_status,
            "ESTIMATOR_STATUS": self._estimator_status,
            "PARAM_VALUE": self._param_value,
            "HEARTBEAT": self._heartbeat,
            "COMMAND_ACK": self._command_ack,
        }

    @property
    def message_names(self) -> frozenset[str]:
        """The messages that become events; all others are skipped."""
        return frozenset(self._handlers)

    def decode(self, message: Any, arrival_us: int) -> list[Event]:
        """The events in one message that arrived at ``arrival_us`` (Unix time, us)."""
        handler = self._handlers.get(message.get_type())
        if handler is None:
            return []
        vehicle = self._vehicle(message.get_srcSystem(), message.get_srcComponent())
        return [] if vehicle is None else handler(vehicle, message, arrival_us)

    def decode_imu(
        self, system_id: int, component_id: int, name: str, fields: Any, arrival_us: int
    ) -> list[Event]:
        """The events in an IMU message that was unpacked by ``drivers.mavlink.imu_messages``."""
        vehicle = self._vehicle(system_id, component_id)
        if vehicle is None:
            return []
        instance = getattr(fields, "id", 0)
        stream = f"{name}:{instance}" if instance else name
        if name == "HIGHRES_IMU":
            return self._highres_imu(vehicle, fields, arrival_us, stream)
        if name == "RAW_IMU":
            return self._raw_imu(vehicle, fields, arrival_us, stream)
        return self._scaled_imu(vehicle, fields, arrival_us, stream)

    def _vehicle(self, system_id: int, component_id: int) -> _Vehicle | None:
        """What is known of a sender; None if there are too many for a link of real ones."""
        vehicle = self._vehicles.get((system_id, component_id))
        if vehicle is None and len(self._vehicles) < MOST_SENDERS:
            address = VehicleId(system_id, component_id)
            vehicle = self._vehicles[address] = _Vehicle(address)
        return vehicle

    # --- IMU

    def _raw_imu(
        self, vehicle: _Vehicle, m: Any, arrival_us: int, stream: str | None = None
    ) -> list[Event]:
        name = stream or _stream_name(m)
        return self._milli_imu(vehicle, name, m, TimeField.TIME_USEC, m.time_usec, arrival_us)

    def _scaled_imu(
        self, vehicle: _Vehicle, m: Any, arrival_us: int, stream: str | None = None
    ) -> list[Event]:
        name, raw_us = stream or _stream_name(m), m.time_boot_ms * 1000
        return self._milli_imu(vehicle, name, m, TimeField.BOOT_MS, raw_us, arrival_us)

    def _milli_imu(
        self, vehicle: _Vehicle, name: str, m: Any, field: TimeField, raw_us: int, arrival_us: int
    ) -> list[Event]:
        """mg, mrad/s, mGauss: MAVLink's units for SCALED_IMU, and RAW_IMU's from ArduPilot."""
        gyr = (m.xgyro * MILLI, m.ygyro * MILLI, m.zgyro * MILLI)
        acc = (m.xacc * MG_M_S2, m.yacc * MG_M_S2, m.zacc * MG_M_S2)
        mag = (m.xmag * MILLI, m.ymag * MILLI, m.zmag * MILLI)
        return self._imu(vehicle, name, field, raw_us, arrival_us, gyr, acc, mag)

    def _highres_imu(
        self, vehicle: _Vehicle, m: Any, arrival_us: int, stream: str | None = None
    ) -> list[Event]:
        gyr, acc = (m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc)
        mag = _in_gauss((m.xmag, m.ymag, m.zmag))
        if m.fields_updated and not m.fields_updated & HIGHRES_IMU_UPDATED_MAG:
            mag = ZERO_VEC3
        name, field = stream or _stream_name(m), TimeField.TIME_USEC
        return self._imu(vehicle, name, field, m.time_usec, arrival_us, gyr, acc, mag)

    def _imu(
        self,
        vehicle: _Vehicle,
        name: str,
        field: TimeField,
        raw_us: int,
        arrival_us: int,
        gyr: Vec3,
        acc: Vec3,
        mag: Vec3,
    ) -> list[Event]:
        stream = vehicle.imu(name)
        if stream is None:
            return [Rejected(vehicle.id, arrival_us, "too_many_streams", name)]
        refusal = refuse_imu(gyr, acc) or stream.faults.refusal(Readings(gyr, acc, mag), raw_us)
        if refusal is not None:
            return [Rejected(vehicle.id, arrival_us, refusal, name)]
        mag_is_stuck = stream.faults.mag_is_stuck
        reading = _Reading(arrival_us, gyr, acc, ZERO_VEC3 if mag_is_stuck else mag)
        placed = vehicle.clock.imu(name, field, raw_us, arrival_us)
        held, stream.held = stream.held, None
        if isinstance(placed, Refused):
            if placed == CLOCK_STEP:
                stream.held = reading  # the next one decides whether the clock began anew
                return [_clock_step(vehicle, held, name)] if held else []
            return [Rejected(vehicle.id, arrival_us, placed.reason, name)]
        events: list[Event] = []
        if held is not None or placed.reset is not None:
            events = self._settle_held(vehicle, stream, held, placed, arrival_us)
        if (blindness := stream.faults.take_blindness()) is not None:
            reason, span_us = blindness
            events.append(TrackLost(vehicle.id, arrival_us, name, reason, span_us * 1e-6))
        if mag_is_stuck:
            events.append(Rejected(vehicle.id, arrival_us, "magnetometer_stuck", name))
        return events + _imu_events(vehicle, stream, reading, placed.time_us, placed.boot_us)

    def _settle_held(
        self,
        vehicle: _Vehicle,
        stream: _ImuStream,
        held: _Reading | None,
        placed: Placed,
        arrival_us: int,
    ) -> list[Event]:
        """The clock's reset, and the sample that waited for it to be confirmed."""
        events = _resets(vehicle, placed, held.arrival_us if held else arrival_us)
        if held is None:
            return events
        if placed.reset is None:
            return [_clock_step(vehicle, held, stream.name)]
        before_us = placed.since_reset_us
        return events + _imu_events(
            vehicle, stream, held, placed.time_us - before_us, placed.boot_us - before_us
        )

    # --- attitudes of others

    def _attitude(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        q = quaternion_from_euler(m.roll, m.pitch, m.yaw)
        return self._autopilot_attitude(vehicle, m, q, arrival_us)

    def _attitude_quaternion(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        q = unit_or_none((m.q1, m.q2, m.q3, m.q4))
        return self._autopilot_attitude(vehicle, m, q, arrival_us)

    def _autopilot_attitude(
        self, vehicle: _Vehicle, m: Any, q: Quaternion | None, arrival_us: int
    ) -> list[Event]:
        if q is None:
            return []
        name = m.get_type()
        placed = _place_boot_ms(vehicle, name, m, arrival_us)
        if placed is None:
            return []
        events = _resets(vehicle, placed, arrival_us)
        events.append(
            ReferenceAttitude(vehicle.id, arrival_us, placed.time_us, "autopilot", name, q)
        )
        return events

    def _sim_state(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        q = unit_or_none((m.q1, m.q2, m.q3, m.q4))
        return _truth(vehicle, m.get_type(), q, arrival_us)

    def _simstate(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        q = quaternion_from_euler(m.roll, m.pitch, m.yaw)
        return _truth(vehicle, m.get_type(), q, arrival_us)

    # --- position and velocity

    def _global_position(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        if m.lat == 0 and m.lon == 0:
            return []  # no solution yet
        placed = _place_boot_ms(vehicle, "GLOBAL_POSITION_INT", m, arrival_us)
        if placed is None:
            return []
        events = _resets(vehicle, placed, arrival_us)
        velocity = (m.vx * 0.01, m.vy * 0.01, m.vz * 0.01)
        events += _filter_velocity(vehicle, m.get_type(), velocity, placed.time_us, arrival_us)
        if vehicle.navigation.believes_place(m.lat * 1e-7, m.lon * 1e-7, arrival_us):
            events.append(_position(vehicle, m, placed.time_us, arrival_us))
        return events

    def _local_position(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        velocity = (m.vx, m.vy, m.vz)
        if not all(map(math.isfinite, velocity)):
            return []
        placed = _place_boot_ms(vehicle, "LOCAL_POSITION_NED", m, arrival_us)
        if placed is None:
            return []
        events = _resets(vehicle, placed, arrival_us)
        events += _filter_velocity(vehicle, m.get_type(), velocity, placed.time_us, arrival_us)
        return events

    def _ekf_status(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        status = filter_status(m.flags, m.velocity_variance)  # a test ratio, whatever its name
        vehicle.navigation.hear_status(status, arrival_us)
        return []

    def _estimator_status(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        vehicle.navigation.hear_status(filter_status(m.flags, m.vel_ratio), arrival_us)
        return []

    def _gps_raw(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        has_fix = m.fix_type >= GPS_FIX_TYPE_3D_FIX
        vehicle.navigation.hear_fix(has_fix, arrival_us)
        if not has_fix or (m.lat == 0 and m.lon == 0):
            return []
        placed = vehicle.clock.other("GPS_RAW_INT", TimeField.GPS, m.time_usec, arrival_us)
        if isinstance(placed, Refused):
            return []
        events: list[Event] = [_position(vehicle, m, placed.time_us, arrival_us)]
        if UNKNOWN_UINT16 not in (m.vel, m.cog):
            sample = _gps_velocity(m, placed.time_us)
            events.append(Velocity(vehicle.id, arrival_us, "GPS_RAW_INT", sample))
        return events

    # --- the rest

    def _param_value(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        value = m.param_value
        kind = INTEGER_PARAMETERS.get(m.param_type)
        if vehicle.autopilot == MAV_AUTOPILOT_PX4 and kind is not None:
            # PX4 puts an integer's bytes into the float field, ArduPilot its value
            value = float(struct.unpack_from("<" + kind, struct.pack("<f", value))[0])
        return [Parameter(vehicle.id, arrival_us, m.param_id, value)]

    def _heartbeat(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        if not is_autopilot(m.autopilot, m.type):
            return []
        vehicle.autopilot = m.autopilot
        return [Heartbeat(vehicle.id, arrival_us, m.autopilot, m.type)]

    def _command_ack(self, vehicle: _Vehicle, m: Any, arrival_us: int) -> list[Event]:
        return [CommandAck(vehicle.id, arrival_us, m.command, m.result)]


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


def _stream_name(m: Any) -> str:
    """The message's name; a second IMU in the same message (field ``id``) is another stream."""
    name: str = m.get_type()
    instance = m.id if "id" in m.fieldnames else 0  # pymavlink's classes have an id of their own
    return f"{name}:{instance}" if instance else name


def _in_gauss(mag: Vec3) -> Vec3:
    """ArduPilot's HIGHRES_IMU was 10^6 too large until early 2026; others send mGauss."""
    largest = max(map(abs, mag))
    if largest > MILLIGAUSS_LIMIT:
        return (mag[0] * 1e-6, mag[1] * 1e-6, mag[2] * 1e-6)
    if largest > GAUSS_LIMIT:
        return (mag[0] * 1e-3, mag[1] * 1e-3, mag[2] * 1e-3)
    return mag


def _imu_events(
    vehicle: _Vehicle, stream: _ImuStream, reading: _Reading, time_us: int, boot_us: int
) -> list[Event]:
    name, arrival_us = stream.name, reading.arrival_us
    vehicle.last_imu_us = time_us
    fresh_mag = stream.mag.fresh(reading.mag_gauss, time_us)
    mag, has_mag = (ZERO_VEC3, False) if fresh_mag is None else (fresh_mag, True)
    sample = ImuSample._make((time_us, reading.gyr_rad_s, reading.acc_m_s2, mag, has_mag))
    events: list[Event] = [Imu(vehicle.id, arrival_us, boot_us, name, sample)]
    complaints = stream.plausibility.look(sample, vehicle.autopilot)
    events.extend(Notice(vehicle.id, arrival_us, f"{name}: {text}") for text in complaints)
    return events


def _clock_step(vehicle: _Vehicle, held: _Reading, name: str) -> Rejected:
    return Rejected(vehicle.id, held.arrival_us, CLOCK_STEP.reason, name)


def _place_boot_ms(vehicle: _Vehicle, name: str, m: Any, arrival_us: int) -> Placed | None:
    placed = vehicle.clock.other(name, TimeField.BOOT_MS, m.time_boot_ms * 1000, arrival_us)
    return None if isinstance(placed, Refused) else placed


def _resets(vehicle: _Vehicle, placed: Placed, arrival_us: int) -> list[Event]:
    if placed.reset is None:
        return []
    if placed.reset.reason == "reboot":
        vehicle.navigation.forget()
    step_s = placed.reset.step_us * 1e-6
    return [ClockReset(vehicle.id, arrival_us, placed.reset.reason, step_s)]


def _truth(vehicle: _Vehicle, name: str, q: Quaternion | None, arrival_us: int) -> list[Event]:
    """The simulator's attitude, at the IMU message it follows: it carries no time of its own.

    A second one behind the same IMU message belongs to one that was lost.
    """
    time_us = vehicle.last_imu_us
    if q is None or time_us is None or vehicle.truth_given_us.get(name) == time_us:
        return []
    vehicle.truth_given_us[name] = time_us
    return [ReferenceAttitude(vehicle.id, arrival_us, time_us, "sim", name, q)]


def _filter_velocity(
    vehicle: _Vehicle, name: str, velocity: Vec3, time_us: int, arrival_us: int
) -> list[Event]:
    """What the autopilot's filter says, as far as it believes itself."""
    sigma_m_s = vehicle.navigation.velocity_sigma_m_s(FILTER_VELOCITY_SIGMA_M_S, arrival_us)
    if sigma_m_s is None:
        return []
    sample = VelocitySample(time_us, velocity, True, sigma_m_s)
    return [Velocity(vehicle.id, arrival_us, name, sample)]


def _position(vehicle: _Vehicle, m: Any, time_us: int, arrival_us: int) -> Position:
    return Position(
        vehicle.id,
        arrival_us,
        time_us,
        m.get_type(),
        latitude_deg=m.lat * 1e-7,
        longitude_deg=m.lon * 1e-7,
        altitude_m=m.alt * MILLI,
    )


def _gps_velocity(m: Any, time_us: int) -> VelocitySample:
    speed_m_s, course_rad = m.vel * 0.01, math.radians(m.cog * 0.01)
    velocity = (speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad), 0.0)
    sigma_m_s = m.vel_acc * MILLI if getattr(m, "vel_acc", 0) else GPS_VELOCITY_SIGMA_M_S
    return VelocitySample(time_us, velocity, False, sigma_m_s, GPS_LATE_SIGMA_S)
