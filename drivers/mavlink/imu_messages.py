"""The IMU messages, ATTITUDE and HEARTBEAT, unpacked straight from their frames.

pymavlink builds a large object of every message; these are the few that come hundreds
of times a second. The classes answer like pymavlink's for the fields that are there.
Fields in wire order from the message definitions in common.xml.
"""

from struct import Struct
from typing import Any, NamedTuple

from drivers.mavlink.constants import (
    ATTITUDE_ID,
    HEARTBEAT_ID,
    HIGHRES_IMU_ID,
    RAW_IMU_ID,
    SCALED_IMU2_ID,
    SCALED_IMU3_ID,
    SCALED_IMU_ID,
)
from drivers.mavlink.framing import Frame


class RawImu(NamedTuple):
    """RAW_IMU."""

    time_usec: int
    xacc: int
    yacc: int
    zacc: int
    xgyro: int
    ygyro: int
    zgyro: int
    xmag: int
    ymag: int
    zmag: int
    id: int
    temperature: int


class ScaledImu(NamedTuple):
    """SCALED_IMU, SCALED_IMU2 and SCALED_IMU3."""

    time_boot_ms: int
    xacc: int
    yacc: int
    zacc: int
    xgyro: int
    ygyro: int
    zgyro: int
    xmag: int
    ymag: int
    zmag: int
    temperature: int


class HighresImu(NamedTuple):
    """HIGHRES_IMU."""

    time_usec: int
    xacc: float
    yacc: float
    zacc: float
    xgyro: float
    ygyro: float
    zgyro: float
    xmag: float
    ymag: float
    zmag: float
    abs_pressure: float
    diff_pressure: float
    pressure_alt: float
    temperature: float
    fields_updated: int
    id: int


class AttitudeMessage(NamedTuple):
    """ATTITUDE."""

    time_boot_ms: int
    roll: float
    pitch: float
    yaw: float
    rollspeed: float
    pitchspeed: float
    yawspeed: float


class HeartbeatMessage(NamedTuple):
    """HEARTBEAT, the fields that somebody wants."""

    custom_mode: int
    type: int
    autopilot: int


_RAW = Struct("<Q9hBh")
_SCALED = Struct("<I9hh")
_HIGHRES = Struct("<Q13fHB")
_ATTITUDE = Struct("<I6f")
_HEARTBEAT = Struct("<IBB3x")
_KINDS: dict[int, tuple[str, Struct, Any]] = {
    RAW_IMU_ID: ("RAW_IMU", _RAW, RawImu._make),
    SCALED_IMU_ID: ("SCALED_IMU", _SCALED, ScaledImu._make),
    SCALED_IMU2_ID: ("SCALED_IMU2", _SCALED, ScaledImu._make),
    SCALED_IMU3_ID: ("SCALED_IMU3", _SCALED, ScaledImu._make),
    HIGHRES_IMU_ID: ("HIGHRES_IMU", _HIGHRES, HighresImu._make),
}
_FREQUENT = {
    **_KINDS,
    ATTITUDE_ID: ("ATTITUDE", _ATTITUDE, AttitudeMessage._make),
    HEARTBEAT_ID: ("HEARTBEAT", _HEARTBEAT, HeartbeatMessage._make),
}


# Where the number of the IMU stands in the payload; other messages have one number an IMU
_ID_AT = {RAW_IMU_ID: 26, HIGHRES_IMU_ID: 62}


def imu_number(frame: Frame) -> int:
    """Which of the vehicle's IMUs the frame is of, where its message is of several; else 0."""
    at = _ID_AT.get(frame.message_id)
    if at is None:
        return 0
    at += frame.payload_at
    return frame.data[at] if at < frame.payload_end else 0


def imu_stream_name(name: str, number: int) -> str:
    """The message's name; a second IMU in the same message (field ``id``) is another stream."""
    return f"{name}:{number}" if number else name


def imu_message_name(message_id: int) -> str | None:
    """The IMU message of that number; None if it is another message's."""
    kind = _KINDS.get(message_id)
    return None if kind is None else kind[0]


def frequent_message(frame: Frame) -> tuple[str, Any] | None:
    """Name and fields of an IMU message, ATTITUDE or HEARTBEAT; None for every other one.

    Zeros at a payload's end are not sent, nor fields that the sender does not know;
    what is longer than we know comes from a newer definition.
    """
    kind = _FREQUENT.get(frame.message_id)
    if kind is None:
        return None
    name, layout, make = kind
    payload = frame.data[frame.payload_at : frame.payload_end]
    missing = layout.size - len(payload)
    if missing > 0:
        payload += bytes(missing)
    return name, make(layout.unpack_from(payload))
