"""What the service publishes: attitude and status, and nothing that is not finite.

Field names and order are the JSON schema. Angles are in degrees here because
people and maps read these records; everything inside is in radians.
"""

import math
from typing import NamedTuple

import msgspec

from drivers.events import VehicleId
from estimator.frames import euler_rad
from estimator.types import Attitude, Quaternion, Vec3
from service.health import State

SCHEMA = 1
AUTOPILOT_COMPONENT = 1  # MAV_COMP_ID_AUTOPILOT1, left out of a vehicle's name


class Confidence(msgspec.Struct, frozen=True):
    """The paper's s_i, as they are now."""

    gravity: float
    magnetic: float


class Sigma(msgspec.Struct, frozen=True):
    """Angles that 68 % of the errors lie under."""

    inclination: float
    heading: float


class AttitudeRecord(msgspec.Struct, frozen=True):
    """One published attitude. ``time_boot_us`` is the same instant on the vehicle's boot clock."""

    schema: int
    time_unix_us: int
    time_boot_us: int
    q_ned_frd: Quaternion
    euler_deg: Vec3  # roll, pitch, yaw; yaw in [0, 360)
    rate_rad_s: Vec3
    gyro_bias_rad_s: Vec3
    error: float
    error_rate: float
    gain: float
    confidence: Confidence
    sigma_deg: Sigma
    heading_reference: str
    state: str
    age_ms: float
    sequence: int


class StatusRecord(msgspec.Struct, frozen=True):
    """How the estimate of one vehicle is doing, once a second."""

    state: str
    imu_message: str | None
    imu_rate_hz: float
    worst_gap_s: float
    rejected: dict[str, int]
    overruns: int
    dropped: int
    sequence: int


class Published(NamedTuple):
    """A record and the vehicle it is about."""

    vehicle: VehicleId
    record: AttitudeRecord | StatusRecord


class Message(NamedTuple):
    """One line for a person."""

    text: str


Output = Published | Message


class Stamp(NamedTuple):
    """What the service adds to an attitude."""

    time_unix_us: int
    time_boot_us: int
    state: State
    age_us: int
    sequence: int


def vehicle_name(vehicle: VehicleId) -> str:
    """The key's middle part: the system id, or ``S-C`` if the component is not the autopilot."""
    if vehicle.component_id == AUTOPILOT_COMPONENT:
        return str(vehicle.system_id)
    return f"{vehicle.system_id}-{vehicle.component_id}"


def attitude_record(attitude: Attitude, stamp: Stamp) -> AttitudeRecord | None:
    """The record, or None if the attitude is not finite throughout."""
    if not is_finite(attitude):
        return None
    return AttitudeRecord(
        schema=SCHEMA,
        time_unix_us=stamp.time_unix_us,
        time_boot_us=stamp.time_boot_us,
        q_ned_frd=attitude.q_ned_frd,
        euler_deg=euler_deg(attitude.q_ned_frd),
        rate_rad_s=attitude.rate_rad_s,
        gyro_bias_rad_s=attitude.gyro_bias_rad_s,
        error=attitude.error,
        error_rate=attitude.error_rate_1_s,
        gain=attitude.gain,
        confidence=Confidence(attitude.confidence_gravity, attitude.confidence_magnetic),
        sigma_deg=Sigma(
            _bound_deg(attitude.sigma_inclination_rad), _bound_deg(attitude.sigma_heading_rad)
        ),
        heading_reference=attitude.heading_reference,
        state=stamp.state.value,
        age_ms=max(0, stamp.age_us) / 1e3,
        sequence=stamp.sequence,
    )


def euler_deg(q_ned_frd: Quaternion) -> Vec3:
    """Roll, pitch and yaw in degrees, yaw in [0, 360)."""
    roll, pitch, yaw = (math.degrees(angle) for angle in euler_rad(q_ned_frd))
    return (roll, pitch, 0.0 if yaw >= 360.0 else yaw)  # the largest yaw may round up


def is_finite(attitude: Attitude) -> bool:
    """Whether every number that must be finite is; an infinite sigma just means "unknown"."""
    numbers = (
        *attitude.q_ned_frd,
        *attitude.rate_rad_s,
        *attitude.gyro_bias_rad_s,
        attitude.error,
        attitude.error_rate_1_s,
        attitude.gain,
        attitude.confidence_gravity,
        attitude.confidence_magnetic,
    )
    return all(map(math.isfinite, numbers))


def _bound_deg(sigma_rad: float) -> float:
    """Degrees, at most a half turn: an unknown angle can be no further off."""
    return math.degrees(sigma_rad) if sigma_rad < math.pi else 180.0
