"""From the estimator's attitude to the published record, in degrees where people read it."""

import math

from estimator.geometry.frames import euler_rad
from estimator.types import Attitude, Quaternion, Vec3
from service.health import State
from service.records import SCHEMA, AttitudeRecord, Confidence, Sigma


def attitude_record(
    attitude: Attitude,
    *,
    time_unix_us: int,
    time_boot_us: int,
    state: State = State.RUNNING,
    age_us: int = 0,
    sequence: int,
) -> AttitudeRecord | None:
    """The record of an attitude whose sample is ``age_us`` old; None if it is not finite."""
    if not is_finite(attitude):
        return None
    return AttitudeRecord(
        schema=SCHEMA,
        time_unix_us=time_unix_us,
        time_boot_us=time_boot_us,
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
        state=state.value,
        age_ms=max(0, age_us) / 1e3,
        sequence=sequence,
    )


def euler_deg(q_ned_frd: Quaternion) -> Vec3:
    """Roll, pitch and yaw in degrees, yaw in [0, 360)."""
    roll_rad, pitch_rad, yaw_rad = euler_rad(q_ned_frd)
    return (math.degrees(roll_rad), math.degrees(pitch_rad), math.degrees(yaw_rad))


def is_finite(attitude: Attitude) -> bool:
    """Whether every number that must be finite is; an infinite sigma just means "unknown"."""
    # one that is not finite makes the sum so; none is large enough for the sum of the others
    total = (
        sum((*attitude.q_ned_frd, *attitude.rate_rad_s, *attitude.gyro_bias_rad_s))
        + attitude.error
        + attitude.error_rate_1_s
        + attitude.gain
        + attitude.confidence_gravity
        + attitude.confidence_magnetic
    )
    return math.isfinite(total)


def _bound_deg(sigma_rad: float) -> float:
    """The bound in degrees, at most half a turn: no angle can be further off."""
    return math.degrees(sigma_rad) if sigma_rad < math.pi else 180.0
