"""Frames to events: MAVLink's units and fields, and who is who.

``MavlinkDecoder`` turns the frames of a link or a log into the events of ``drivers.events``,
without any I/O, and unpacks only what somebody wants. Units change here and nowhere else:
mg, mrad/s, mGauss, cm/s and degrees come in, SI, radians and gauss go out. Body axes are
FRD on both sides.
"""

import math
from collections.abc import Callable
from math import isfinite
from typing import Any

from drivers.events import (
    BuiltIn,
    CommandAck,
    Event,
    Forgotten,
    Heartbeat,
    Parameter,
    VehicleId,
)
from drivers.mavlink.constants import (
    AUTOPILOT_VERSION_ID,
    GPS_FIX_TYPE_3D_FIX,
    HIGHRES_IMU_UPDATED_MAG,
    MAV_AUTOPILOT_ARDUPILOTMEGA,
    MAV_AUTOPILOT_PX4,
    UNKNOWN_UINT16,
    is_autopilot,
)
from drivers.mavlink.dialect import Unpacker, mavlink
from drivers.mavlink.framing import Frame
from drivers.mavlink.imu_messages import frequent_message, imu_stream_name
from drivers.mavlink.parameter_values import ParameterValue, WaitingParameters, owner
from drivers.samples.fix import Fix
from drivers.samples.intake import Intake, Stamp
from drivers.samples.navigation import filter_status
from drivers.samples.rotation import quaternion_from_euler, unit_or_none
from drivers.samples.vehicle_clock import TimeField
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3

MG_M_S2 = STANDARD_GRAVITY_M_S2 / 1000.0
MILLI = 1e-3
CENTI = 1e-2
DEGREES_1E7 = 1e-7

GAUSS_LIMIT = 20.0  # the Earth's field is 0.25..0.65 gauss; more is another unit
MILLIGAUSS_LIMIT = 20_000.0

FRD_AUTOPILOTS = (MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_AUTOPILOT_PX4)  # known for sending FRD

MOST_SENDERS = 512  # addresses remembered at once; each takes 11 kB
# When all places are taken, one that has been silent for so long may lose its own to a new one
SILENT_US = 5_000_000
LOOK_US = 1_000_000  # and if there is none, it is not looked for again before that

# What fuzzbee's own vehicle puts where others have a commit
BUILT_IN = "fuzzbee"

# Attitudes of others score an estimate afterwards; the live service has no use for them
REFERENCES = frozenset({"ATTITUDE_QUATERNION", "SIM_STATE", "SIMSTATE"})


class _Sender:
    """What the decoder remembers about one address."""

    def __init__(self, address: VehicleId) -> None:
        self.id = address
        self.autopilot: int | None = None
        self.version = b""  # the payload of its last AUTOPILOT_VERSION, and what that says
        self.motion: str | None = None
        self.intake = Intake(address)
        self.heard_us = 0  # host's Unix time


class MavlinkDecoder:
    """Frames in, events out, for any number of vehicles.

    ``references`` says whether attitudes of others are wanted; ``wanted`` holds the numbers
    of the messages that become events, all others are skipped.
    """

    def __init__(self, *, references: bool = True) -> None:
        self._unpacker = Unpacker()
        self._senders: dict[tuple[int, int], _Sender] = {}
        self._full_since_us: int | None = None  # nobody was silent then
        self._parameters = WaitingParameters()
        self._handlers: dict[str, Callable[[_Sender, str, Any, int], list[Event]]] = {
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
        self._references = references
        names = {*self._handlers, "AUTOPILOT_VERSION"} - (frozenset() if references else REFERENCES)
        kinds = mavlink().mavlink_map.items()
        self.wanted = frozenset(number for number, kind in kinds if kind.msgname in names)

    def events(self, frame: Frame, arrival_us: int) -> list[Event]:
        """The events in one frame that arrived at ``arrival_us`` (Unix time, us)."""
        if frame.message_id not in self.wanted:
            return []
        sender = self._senders.get((frame.system_id, frame.component_id))
        if sender is None:
            return self._meet(frame, arrival_us)
        sender.heard_us = arrival_us
        return self._events(sender, frame, arrival_us)

    def _events(self, sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
        frequent = frequent_message(frame)
        if frequent is not None:
            name, fields = frequent
            return self._handlers[name](sender, name, fields, arrival_us)
        if frame.message_id == AUTOPILOT_VERSION_ID:
            return self._repeated_version(sender, frame, arrival_us)
        message = self._unpacker.message(frame.data)
        if message is None:
            return []
        name = message.get_type()
        return self._handlers[name](sender, name, message, arrival_us)

    def _repeated_version(self, sender: _Sender, frame: Frame, arrival_us: int) -> list[Event]:
        """What an AUTOPILOT_VERSION says, which is unpacked only if it has not just been said."""
        payload = frame.data[frame.payload_at : frame.payload_end]
        if payload != sender.version:
            message = self._unpacker.message(frame.data)
            sender.version, sender.motion = payload, None if message is None else _motion(message)
        return [] if sender.motion is None else [BuiltIn(sender.id, arrival_us, sender.motion)]

    def _meet(self, frame: Frame, arrival_us: int) -> list[Event]:
        """The events of a new sender; none if there are too many for a link of real ones."""
        gone: list[Event] = []
        if len(self._senders) >= MOST_SENDERS:
            silent = self._longest_silent(arrival_us)
            if silent is None:
                return []
            del self._senders[silent]
            gone = [Forgotten(silent, arrival_us)]
        address = VehicleId(frame.system_id, frame.component_id)
        sender = self._senders[address] = _Sender(address)
        sender.heard_us = arrival_us
        return gone + self._events(sender, frame, arrival_us)

    def _longest_silent(self, now_us: int) -> VehicleId | None:
        """Who may lose its place; first those without an IMU: no flood takes a vehicle's.

        Silence is looked for once a second at most: a flood must not cost a search a frame.
        """
        full_since_us = self._full_since_us
        if full_since_us is not None and 0 <= now_us - full_since_us < LOOK_US:
            return None
        silent = [each for each in self._senders.values() if now_us - each.heard_us >= SILENT_US]
        self._full_since_us = None if silent else now_us
        if not silent:
            return None
        return min(silent, key=lambda each: (each.intake.has_imu, each.heard_us)).id

    # --- IMU

    def _raw_imu(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        stamp = Stamp(TimeField.TIME_USEC, m.time_usec, arrival_us)
        return _milli_imu(sender, imu_stream_name(name, m.id), m, stamp)

    def _scaled_imu(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        return _milli_imu(sender, name, m, _boot_ms(m, arrival_us))

    def _highres_imu(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        gyr, acc = (m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc)
        mag = _in_gauss((m.xmag, m.ymag, m.zmag))
        if m.fields_updated and not m.fields_updated & HIGHRES_IMU_UPDATED_MAG:
            mag = ZERO_VEC3
        stamp = Stamp(TimeField.TIME_USEC, m.time_usec, arrival_us)
        return sender.intake.imu(imu_stream_name(name, m.id), stamp, gyr, acc, mag)

    # --- attitudes of others

    def _attitude(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        roll, pitch, yaw = m.roll, m.pitch, m.yaw
        rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
        stamp = _boot_ms(m, arrival_us)
        if self._references:
            q = quaternion_from_euler(roll, pitch, yaw)
            return sender.intake.attitude(name, stamp, "autopilot", q, rates)
        if not (isfinite(roll) and isfinite(pitch) and isfinite(yaw)):
            return []  # as little believed as the angles beside it
        return sender.intake.rates(name, stamp, rates)

    def _attitude_quaternion(
        self, sender: _Sender, name: str, m: Any, arrival_us: int
    ) -> list[Event]:
        return sender.intake.attitude(name, _boot_ms(m, arrival_us), "autopilot", _quaternion(m))

    def _sim_state(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        return sender.intake.truth(name, arrival_us, _quaternion(m))

    def _simstate(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        q = quaternion_from_euler(m.roll, m.pitch, m.yaw)
        return sender.intake.truth(name, arrival_us, q)

    # --- position and velocity

    def _global_position(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        velocity = (m.vx * CENTI, m.vy * CENTI, m.vz * CENTI)
        fix = Fix(velocity, position=_position(m))
        return sender.intake.fix(name, _boot_ms(m, arrival_us), fix)

    def _local_position(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        velocity = (m.vx, m.vy, m.vz)
        if not all(map(math.isfinite, velocity)):
            return []
        return sender.intake.fix(name, _boot_ms(m, arrival_us), Fix(velocity))

    def _gps_raw(self, sender: _Sender, name: str, m: Any, arrival_us: int) -> list[Event]:
        has_fix = m.fix_type >= GPS_FIX_TYPE_3D_FIX
        sender.intake.navigation.hear_fix(has_fix, arrival_us)
        if not has_fix:
            return []
        fix = Fix(position=_position(m))
        if UNKNOWN_UINT16 not in (m.vel, m.cog):
            # an extension of MAVLink 2, zero where it is unknown
            sigma_m_s = m.vel_acc * MILLI if getattr(m, "vel_acc", 0) else None
            fix = fix._replace(
                velocity_ned_m_s=_course_velocity(m), has_vertical=False, sigma_m_s=sigma_m_s
            )
        stamp = Stamp(TimeField.GPS, m.time_usec, arrival_us)
        return sender.intake.fix(name, stamp, fix)

    def _ekf_status(self, sender: _Sender, _name: str, m: Any, arrival_us: int) -> list[Event]:
        status = filter_status(m.flags, m.velocity_variance)  # a test ratio, whatever its name
        sender.intake.navigation.hear_status(status, arrival_us)
        return []

    def _estimator_status(
        self, sender: _Sender, _name: str, m: Any, arrival_us: int
    ) -> list[Event]:
        status = filter_status(m.flags, m.vel_ratio)
        sender.intake.navigation.hear_status(status, arrival_us)
        return []

    # --- the rest

    def _param_value(self, sender: _Sender, _name: str, m: Any, arrival_us: int) -> list[Event]:
        value = ParameterValue(m.param_id, m.param_value, m.param_type)
        address = owner(sender.id, self._autopilots())
        if address is None:
            self._parameters.hold(sender.id.system_id, value)
            return []
        autopilot = self._senders[address.system_id, address.component_id].autopilot
        return [Parameter(address, arrival_us, value.name, value.value(autopilot))]

    def _autopilots(self) -> list[VehicleId]:
        """Who has said so, or sends IMU data."""
        known = self._senders.values()
        return [each.id for each in known if each.autopilot is not None or each.intake.has_imu]

    def _heartbeat(self, sender: _Sender, _name: str, m: Any, arrival_us: int) -> list[Event]:
        if not is_autopilot(m.autopilot, m.type):
            return []
        sender.autopilot = m.autopilot
        sender.intake.doubts_axes = m.autopilot not in FRD_AUTOPILOTS
        beat = Heartbeat(sender.id, arrival_us, m.autopilot, m.type)
        waiting = self._parameters.take(sender.id.system_id)
        return [
            beat,
            *(Parameter(sender.id, arrival_us, p.name, p.value(m.autopilot)) for p in waiting),
        ]

    def _command_ack(self, sender: _Sender, _name: str, m: Any, arrival_us: int) -> list[Event]:
        return [CommandAck(sender.id, arrival_us, m.command, m.result)]


def _motion(m: Any) -> str | None:
    """The motion of fuzzbee's own vehicle, by its AUTOPILOT_VERSION; None if it is another's."""
    if _text(m.flight_custom_version) != BUILT_IN:
        return None
    return _text(m.middleware_custom_version)


def _text(letters: list[int]) -> str:
    """What the letters before the first zero say."""
    return bytes(letters).split(b"\0", 1)[0].decode("ascii", "replace")


def _milli_imu(sender: _Sender, stream: str, m: Any, stamp: Stamp) -> list[Event]:
    """mg, mrad/s, mGauss: MAVLink's units for SCALED_IMU, and RAW_IMU's from ArduPilot.

    Autopilots cut the digits behind the point off, which is half a unit towards zero in the
    mean: a bias that changes its sign with the reading, of 0.5 mrad/s for a gyroscope. So a
    reading stands for the middle of what it may have been.
    """
    gyr = (_middle(m.xgyro) * MILLI, _middle(m.ygyro) * MILLI, _middle(m.zgyro) * MILLI)
    acc = (_middle(m.xacc) * MG_M_S2, _middle(m.yacc) * MG_M_S2, _middle(m.zacc) * MG_M_S2)
    mag = (_middle(m.xmag) * MILLI, _middle(m.ymag) * MILLI, _middle(m.zmag) * MILLI)
    return sender.intake.imu(stream, stamp, gyr, acc, mag)


def _middle(cut: int) -> float:
    """The middle of all numbers that are ``cut`` without the digits behind their point."""
    return cut + 0.5 if cut > 0 else cut - 0.5 if cut < 0 else 0.0


def _boot_ms(m: Any, arrival_us: int) -> Stamp:
    return Stamp(TimeField.BOOT_MS, m.time_boot_ms * 1000, arrival_us)


def _in_gauss(mag: Vec3) -> Vec3:
    """ArduPilot's HIGHRES_IMU was 10^6 too large until early 2026; others send mGauss."""
    largest = max(map(abs, mag))
    if largest > MILLIGAUSS_LIMIT:
        return (mag[0] * 1e-6, mag[1] * 1e-6, mag[2] * 1e-6)
    if largest > GAUSS_LIMIT:
        return (mag[0] * 1e-3, mag[1] * 1e-3, mag[2] * 1e-3)
    return mag


def _quaternion(m: Any) -> Quaternion | None:
    return unit_or_none((m.q1, m.q2, m.q3, m.q4))


def _position(m: Any) -> Vec3:
    """Latitude and longitude in degrees, altitude in m."""
    return (m.lat * DEGREES_1E7, m.lon * DEGREES_1E7, m.alt * MILLI)


def _course_velocity(m: Any) -> Vec3:
    """NED velocity in m/s from speed (cm/s) and course over ground (0.01 degrees)."""
    speed_m_s, course_rad = m.vel * CENTI, math.radians(m.cog * CENTI)
    return (speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad), 0.0)
