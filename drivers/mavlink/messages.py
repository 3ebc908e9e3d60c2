"""The tables of messages: IMU messages, and others of attitude, velocity, position and status.

Each entry holds everything that is known of a message. Decoder, queue, choice among several IMU
messages, requests for a rate and advice about logs ask these tables. Units change here and nowhere
else: mg, mGauss, cm/s and degrees come in, SI, gauss and radians go out.
"""

import math
from collections.abc import Callable
from functools import cache, partial
from math import isfinite
from struct import calcsize
from typing import Any, NamedTuple

from drivers.events import BodyRates, Event, Value
from drivers.mavlink import constants as mav
from drivers.mavlink.framing import Frame, layout
from drivers.samples.imu_stream import Stamp
from drivers.samples.intake import Intake
from drivers.samples.navigation import Fix, Source, quaternion_from_euler, unit_or_none
from drivers.samples.vehicle_clock import TimeField
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, RateSample, Vec3

MG_M_S2 = STANDARD_GRAVITY_M_S2 / 1000.0
MILLI = 1e-3
CENTI = 1e-2
DEGREES_1E7 = 1e-7
GAUSS_LIMIT = 20.0  # the Earth's field is 0.25..0.65 gauss; more is another unit
MILLIGAUSS_LIMIT = 20_000.0

USEC, BOOT_MS = TimeField.TIME_USEC, TimeField.BOOT_MS

Vectors = tuple[Vec3, Vec3, Vec3]


# --- IMU messages


def milli_vectors(m: Any) -> Vectors:
    """The vectors of a message in mrad/s, mg and mGauss: SCALED_IMU, and RAW_IMU of ArduPilot.

    Autopilots cut off the digits after the decimal point, which moves readings towards zero by
    half a unit on average: a bias of 0.5 mrad/s for a gyroscope, whose sign is that of the
    reading. So a reading is taken for the middle of the values that it may stand for.
    """
    return (
        _middles(m.xgyro, m.ygyro, m.zgyro, MILLI),
        _middles(m.xacc, m.yacc, m.zacc, MG_M_S2),
        _middles(m.xmag, m.ymag, m.zmag, MILLI),
    )


def _middles(x: int, y: int, z: int, unit: float) -> Vec3:
    """The middles of all numbers that become x, y and z when their decimals are cut off."""
    return (
        (x + 0.5 * ((x > 0) - (x < 0))) * unit,
        (y + 0.5 * ((y > 0) - (y < 0))) * unit,
        (z + 0.5 * ((z > 0) - (z < 0))) * unit,
    )


def highres_vectors(m: Any) -> Vectors:
    """The vectors of HIGHRES_IMU: rad/s, m/s^2, gauss; a field that was not updated is zero.

    ArduPilot's field was 10^6 too large until early 2026; others send mGauss.
    """
    largest, unit = max(abs(m.xmag), abs(m.ymag), abs(m.zmag)), 1.0
    if largest > MILLIGAUSS_LIMIT:
        unit = 1e-6
    elif largest > GAUSS_LIMIT:
        unit = MILLI
    mag = (m.xmag * unit, m.ymag * unit, m.zmag * unit)
    if m.fields_updated and not m.fields_updated & mav.HIGHRES_IMU_UPDATED_MAG:
        mag = ZERO_VEC3
    return (m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc), mag


class ImuMessage(NamedTuple):
    """One IMU message of pymavlink's ardupilotmega dialect.

    ``clock`` is the kind of its time: TIME_USEC of a field ``time_usec``, BOOT_MS of a field
    ``time_boot_ms``. ``vectors`` makes of its fields (as attributes, by their names in the
    dialect) angular rate (rad/s), specific force (m/s^2) and magnetic field (gauss; zero where it
    has none), all FRD. A field ``id``, if any, is the number of the IMU. The autopilots in
    ``asked_of`` (MAV_AUTOPILOT) are asked for this message; ``setting`` makes them send it.
    """

    number: int
    name: str
    clock: TimeField
    vectors: Callable[[Any], Vectors]
    asked_of: tuple[int, ...] = ()
    setting: str = ""


# In the order of preference: RAW_IMU and HIGHRES_IMU keep the finest clock; the numbered ones are
# the second and third IMU.
IMU_MESSAGES: dict[int, ImuMessage] = {
    each.number: each
    for each in (
        ImuMessage(mav.RAW_IMU_ID, "RAW_IMU", USEC, milli_vectors, setting="SR*_RAW_SENS = 50"),
        ImuMessage(
            mav.HIGHRES_IMU_ID,
            "HIGHRES_IMU",
            USEC,
            highres_vectors,
            asked_of=(mav.MAV_AUTOPILOT_PX4,),
            setting="mavlink stream -r 50 -s HIGHRES_IMU",
        ),
        ImuMessage(mav.SCALED_IMU_ID, "SCALED_IMU", BOOT_MS, milli_vectors),
        ImuMessage(mav.SCALED_IMU2_ID, "SCALED_IMU2", BOOT_MS, milli_vectors),
        ImuMessage(mav.SCALED_IMU3_ID, "SCALED_IMU3", BOOT_MS, milli_vectors),
    )
}

IMU_RANKS = {each.name: rank for rank, each in enumerate(IMU_MESSAGES.values())}


def imu_rank(message: str) -> int:
    """Place of an IMU message in the order of preference; names that only logs use come last."""
    return IMU_RANKS.get(message, len(IMU_RANKS))


def message_to_ask_for(autopilot: int | None) -> ImuMessage:
    """The message to request from a vehicle of that MAV_AUTOPILOT; RAW_IMU where no entry fits."""
    asked = (each for each in IMU_MESSAGES.values() if autopilot in each.asked_of)
    return next(asked, IMU_MESSAGES[mav.RAW_IMU_ID])


def imu_stream_name(name: str, number: int) -> str:
    """The message's name; a second IMU in the same message (field ``id``) is another stream."""
    return f"{name}:{number}" if number else name


def imu_number(frame: Frame) -> int:
    """The number of the vehicle's IMU in the field ``id`` of an IMU message's frame, or 0."""
    offset = _number_offset(frame.message_id)
    at = frame.payload_end if offset is None else frame.payload_at + offset
    return frame.data[at] if at < frame.payload_end else 0


@cache
def _number_offset(message_id: int) -> int | None:
    """Where the field ``id`` stands in the payload; None if the message has none, or has arrays."""
    known = layout(message_id)
    if known is None or "id" not in known.names:
        return None
    codes = known.struct.format.lstrip("<")
    return calcsize("<" + codes[: known.names.index("id")])


# --- other messages


class Received(Value, frozen=True):
    """A message's name, its fields as attributes, and when it arrived (host's Unix time)."""

    name: str
    fields: Any
    arrival_us: int

    @property
    def boot_stamp(self) -> Stamp:
        """The time of a message that has ``time_boot_ms``."""
        return Stamp(TimeField.BOOT_MS, self.fields.time_boot_ms * 1000, self.arrival_us)


class MessageKind(NamedTuple):
    """A message that becomes events.

    ``events`` takes the sender's intake, which judges readings and places them in time, and the
    message. A message with ``is_reference`` serves only to compare attitudes, and is left out where
    nobody wants that. One that ``is_wanted`` (of the intake and the arrival) refuses is not
    unpacked. Each message makes the one before it old: under overload only the newest is handled.
    """

    number: int
    name: str
    events: Callable[[Intake, Received], list[Event]]
    is_reference: bool = False
    is_wanted: Callable[[Intake, int], bool] | None = None


# --- attitudes of others


def _attitude(intake: Intake, message: Received) -> list[Event]:
    m, stamp = message.fields, message.boot_stamp
    rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
    if intake.wants_attitude(message.arrival_us):
        return intake.attitude(message.name, stamp, "autopilot", _from_euler(m), rates)
    if not (isfinite(m.roll) and isfinite(m.pitch) and isfinite(m.yaw)):
        return []  # the rates are then as wrong as the angles
    return intake.report(message.name, stamp, lambda us: RateSample(us, rates), BodyRates)


def _attitude_quaternion(intake: Intake, message: Received) -> list[Event]:
    q = _quaternion(message.fields)
    return intake.attitude(message.name, message.boot_stamp, "autopilot", q)


def _unstamped(
    source: Source, read: Callable[[Any], Quaternion | None], intake: Intake, message: Received
) -> list[Event]:
    return intake.unstamped(message.name, message.arrival_us, source, read(message.fields))


def _from_euler(m: Any) -> Quaternion | None:
    return quaternion_from_euler(m.roll, m.pitch, m.yaw)


def _quaternion(m: Any) -> Quaternion | None:
    return unit_or_none((m.q1, m.q2, m.q3, m.q4))


# --- position and velocity


def _global_position(intake: Intake, message: Received) -> list[Event]:
    m = message.fields
    velocity = (m.vx * CENTI, m.vy * CENTI, m.vz * CENTI)
    return intake.fix(message.name, message.boot_stamp, Fix(velocity, position=_position(m)))


def _local_position(intake: Intake, message: Received) -> list[Event]:
    velocity = (message.fields.vx, message.fields.vy, message.fields.vz)
    if not all(map(isfinite, velocity)):
        return []
    return intake.fix(message.name, message.boot_stamp, Fix(velocity))


def _gps_raw(intake: Intake, message: Received) -> list[Event]:
    m = message.fields
    has_fix = m.fix_type >= mav.GPS_FIX_TYPE_3D_FIX
    intake.navigation.update_fix(has_fix, message.arrival_us)
    if not has_fix:
        return []
    fix = Fix(position=_position(m))
    if mav.UNKNOWN_UINT16 not in (m.vel, m.cog):
        # vel_acc is an extension of MAVLink 2, zero where it is unknown
        sigma_m_s = m.vel_acc * MILLI if m.vel_acc else None
        speed_m_s, course_rad = m.vel * CENTI, math.radians(m.cog * CENTI)
        velocity = speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad), 0.0
        fix = fix._replace(velocity_ned_m_s=velocity, has_vertical=False, sigma_m_s=sigma_m_s)
    return intake.fix(message.name, Stamp(TimeField.GPS, m.time_usec, message.arrival_us), fix)


def _position(m: Any) -> Vec3:
    """Latitude and longitude in degrees, altitude in m."""
    return (m.lat * DEGREES_1E7, m.lon * DEGREES_1E7, m.alt * MILLI)


# --- the status of the autopilot's filter


def _filter_status(
    velocity_ratio: str, compass_ratio: str, intake: Intake, message: Received
) -> list[Event]:
    """Its flags, and two test ratios, whatever their names."""
    ratios = (getattr(message.fields, name) for name in (velocity_ratio, compass_ratio))
    return intake.filter_status(message.arrival_us, message.fields.flags, *ratios)


def _kind(
    name: str, events: Callable[[Intake, Received], list[Event]], **options: Any
) -> MessageKind:
    """The entry of a message, whose number is the dialect's."""
    return MessageKind(getattr(mav, f"{name}_ID"), name, events, **options)


MESSAGES: dict[int, MessageKind] = {
    each.number: each
    for each in (
        _kind("ATTITUDE", _attitude),
        _kind("ATTITUDE_QUATERNION", _attitude_quaternion, is_wanted=Intake.wants_attitude),
        # the autopilot's second filter
        _kind("AHRS2", partial(_unstamped, "autopilot", _from_euler)),
        _kind("SIM_STATE", partial(_unstamped, "sim", _quaternion), is_reference=True),
        _kind("SIMSTATE", partial(_unstamped, "sim", _from_euler), is_reference=True),
        _kind("GLOBAL_POSITION_INT", _global_position),
        _kind("LOCAL_POSITION_NED", _local_position),
        _kind("GPS_RAW_INT", _gps_raw),
        _kind(
            "EKF_STATUS_REPORT", partial(_filter_status, "velocity_variance", "compass_variance")
        ),
        _kind("ESTIMATOR_STATUS", partial(_filter_status, "vel_ratio", "mag_ratio")),
    )
}
