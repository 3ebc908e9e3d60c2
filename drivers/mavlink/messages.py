"""The table of what vehicles say beside their IMU messages: attitudes, velocity, position, status.

Each entry makes events of a message's fields. Units change here and in ``imu_messages`` and nowhere
else: cm/s and degrees come in, SI and radians go out.
"""

import math
from collections.abc import Callable
from functools import partial
from math import isfinite
from typing import Any, NamedTuple

from drivers.events import Event
from drivers.mavlink import constants as mav
from drivers.samples.imu_stream import Stamp
from drivers.samples.intake import Intake
from drivers.samples.navigation import Fix, Source, quaternion_from_euler, unit_or_none
from drivers.samples.vehicle_clock import TimeField
from estimator.types import Quaternion, Vec3

MILLI = 1e-3
CENTI = 1e-2
DEGREES_1E7 = 1e-7


class Said(NamedTuple):
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

    ``events`` takes the sender's intake, which judges readings and places them in time, and what
    was said. A message with ``is_reference`` is for nothing but the comparison with an attitude of
    somebody else, and left out where nobody wants that. One that ``is_wanted`` (of the intake and
    the arrival) refuses is not unpacked. Each message makes the one before it old:
    under overload only the newest is handled.
    """

    number: int
    name: str
    events: Callable[[Intake, Said], list[Event]]
    is_reference: bool = False
    is_wanted: Callable[[Intake, int], bool] | None = None


# --- attitudes of others


def _attitude(intake: Intake, said: Said) -> list[Event]:
    m, stamp = said.fields, said.boot_stamp
    rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
    if intake.wants_attitude(said.arrival_us):
        return intake.attitude(said.name, stamp, "autopilot", _from_euler(m), rates)
    if not (isfinite(m.roll) and isfinite(m.pitch) and isfinite(m.yaw)):
        return []  # as little believed as the angles beside it
    return intake.rates(said.name, stamp, rates)


def _attitude_quaternion(intake: Intake, said: Said) -> list[Event]:
    return intake.attitude(said.name, said.boot_stamp, "autopilot", _quaternion(said.fields))


def _unstamped(
    source: Source, read: Callable[[Any], Quaternion | None], intake: Intake, said: Said
) -> list[Event]:
    return intake.unstamped(said.name, said.arrival_us, source, read(said.fields))


def _from_euler(m: Any) -> Quaternion | None:
    return quaternion_from_euler(m.roll, m.pitch, m.yaw)


def _quaternion(m: Any) -> Quaternion | None:
    return unit_or_none((m.q1, m.q2, m.q3, m.q4))


# --- position and velocity


def _global_position(intake: Intake, said: Said) -> list[Event]:
    m = said.fields
    velocity = (m.vx * CENTI, m.vy * CENTI, m.vz * CENTI)
    return intake.fix(said.name, said.boot_stamp, Fix(velocity, position=_position(m)))


def _local_position(intake: Intake, said: Said) -> list[Event]:
    m = said.fields
    velocity = (m.vx, m.vy, m.vz)
    if not all(map(isfinite, velocity)):
        return []
    return intake.fix(said.name, said.boot_stamp, Fix(velocity))


def _gps_raw(intake: Intake, said: Said) -> list[Event]:
    m = said.fields
    has_fix = m.fix_type >= mav.GPS_FIX_TYPE_3D_FIX
    intake.navigation.update_fix(has_fix, said.arrival_us)
    if not has_fix:
        return []
    fix = Fix(position=_position(m))
    if mav.UNKNOWN_UINT16 not in (m.vel, m.cog):
        # vel_acc is an extension of MAVLink 2, zero where it is unknown
        sigma_m_s = m.vel_acc * MILLI if m.vel_acc else None
        fix = fix._replace(
            velocity_ned_m_s=_course_velocity(m), has_vertical=False, sigma_m_s=sigma_m_s
        )
    return intake.fix(said.name, Stamp(TimeField.GPS, m.time_usec, said.arrival_us), fix)


def _position(m: Any) -> Vec3:
    """Latitude and longitude in degrees, altitude in m."""
    return (m.lat * DEGREES_1E7, m.lon * DEGREES_1E7, m.alt * MILLI)


def _course_velocity(m: Any) -> Vec3:
    """NED velocity in m/s from speed (cm/s) and course over ground (0.01 degrees)."""
    speed_m_s, course_rad = m.vel * CENTI, math.radians(m.cog * CENTI)
    return (speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad), 0.0)


# --- what the autopilot's filter says of itself


def _ekf_status(intake: Intake, said: Said) -> list[Event]:
    m = said.fields
    # test ratios, whatever their names
    return intake.filter_status(said.arrival_us, m.flags, m.velocity_variance, m.compass_variance)


def _estimator_status(intake: Intake, said: Said) -> list[Event]:
    m = said.fields
    return intake.filter_status(said.arrival_us, m.flags, m.vel_ratio, m.mag_ratio)


MESSAGES: dict[int, MessageKind] = {
    each.number: each
    for each in (
        MessageKind(mav.ATTITUDE_ID, "ATTITUDE", _attitude),
        MessageKind(
            mav.ATTITUDE_QUATERNION_ID,
            "ATTITUDE_QUATERNION",
            _attitude_quaternion,
            is_wanted=Intake.wants_attitude,
        ),
        # the autopilot's second filter
        MessageKind(mav.AHRS2_ID, "AHRS2", partial(_unstamped, "autopilot", _from_euler)),
        MessageKind(
            mav.SIM_STATE_ID,
            "SIM_STATE",
            partial(_unstamped, "sim", _quaternion),
            is_reference=True,
        ),
        MessageKind(
            mav.SIMSTATE_ID, "SIMSTATE", partial(_unstamped, "sim", _from_euler), is_reference=True
        ),
        MessageKind(mav.GLOBAL_POSITION_INT_ID, "GLOBAL_POSITION_INT", _global_position),
        MessageKind(mav.LOCAL_POSITION_NED_ID, "LOCAL_POSITION_NED", _local_position),
        MessageKind(mav.GPS_RAW_INT_ID, "GPS_RAW_INT", _gps_raw),
        MessageKind(mav.EKF_STATUS_REPORT_ID, "EKF_STATUS_REPORT", _ekf_status),
        MessageKind(mav.ESTIMATOR_STATUS_ID, "ESTIMATOR_STATUS", _estimator_status),
    )
}
