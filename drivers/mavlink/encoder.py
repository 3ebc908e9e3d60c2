"""Values to MAVLink 2 frames, for the few messages that we send ourselves.

No I/O and no clock. Packing by ``struct`` takes 2 us a frame, a fifteenth of
what pymavlink's classes take, so that one core can play hundreds of vehicles. SI units come
in, MAVLink's go out. Fields are packed by pymavlink's definitions, in wire order.

Source of the frames' layout: https://mavlink.io/en/guide/serialization.html and
https://mavlink.io/en/guide/message_signing.html.
"""

import hashlib
import re
from collections.abc import Callable
from math import copysign
from struct import Struct
from typing import NamedTuple

from fastcrc import crc16

from drivers.events import VehicleId
from drivers.mavlink import constants as mav
from drivers.mavlink.constants import mavlink
from drivers.mavlink.framing import SIGNED_FLAG
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Quaternion, Vec3

SIGNING_EPOCH_US = 1_420_070_400_000_000  # 2015-01-01 00:00 GMT, in Unix time
SIGNING_TICK_US = 10

_HEADER = Struct("<BBBBBBHB")  # after the marker; the message id has 24 bits

_MG = 1000.0 / STANDARD_GRAVITY_M_S2
STATUSTEXT_SIZE = 50
HEX_KEY = re.compile(rb"[0-9A-Fa-f]{64}")
LAST_BITS = 1e-9  # of a unit, by which scaling may miss a whole number


class Message(NamedTuple):
    """A message ready for a frame: number, CRC_EXTRA of its definition, whole payload."""

    id: int
    crc_extra: int
    payload: bytes


class FrameEncoder:
    """Numbers, checks and, with a key of 32 bytes, signs the frames of one sender.

    ``stamp`` gives a signature's time stamp from the Unix time in us, each above the last;
    without it they begin with the first frame's time.
    """

    def __init__(
        self,
        sender: VehicleId,
        key: bytes | None = None,
        link_id: int = 0,
        stamp: Callable[[int], int] | None = None,
    ) -> None:
        assert key is None or len(key) == 32
        self._sender = sender
        self._key = key
        self._link_id = link_id
        self._stamp = stamp or self._next_stamp
        self._sequence = 0
        self._signing_ticks = 0

    def frame(self, message: Message, unix_us: int) -> bytes:
        """The next frame. ``unix_us`` is the time that a signature carries."""
        # trailing zeros are not sent, except the first byte
        payload = message.payload.rstrip(b"\0") or b"\0"
        flags, (page, number) = SIGNED_FLAG if self._key else 0, divmod(message.id, 1 << 16)
        body = _HEADER.pack(len(payload), flags, 0, self._sequence, *self._sender, number, page)
        body += payload
        self._sequence = (self._sequence + 1) & 0xFF
        checksum = crc16.mcrf4xx(body + bytes((message.crc_extra,)))
        frame = b"\xfd" + body + checksum.to_bytes(2, "little")
        if self._key is None:
            return frame
        frame += bytes((self._link_id,)) + self._stamp(unix_us).to_bytes(6, "little")
        return frame + hashlib.sha256(self._key + frame).digest()[:6]

    def _next_stamp(self, unix_us: int) -> int:
        # it must grow with every frame, also within one tick of 10 us
        now = (unix_us - SIGNING_EPOCH_US) // SIGNING_TICK_US
        self._signing_ticks = max(self._signing_ticks + 1, now)
        return self._signing_ticks


def _message(number: int, *fields: float | bytes) -> Message:
    """The message of those fields, in the order of the wire."""
    kind = mavlink().mavlink_map[number]
    return Message(number, kind.crc_extra, kind.unpacker.pack(*fields))


def heartbeat(vehicle_type: int, autopilot: int, state: int = mav.MAV_STATE_ACTIVE) -> Message:
    """HEARTBEAT of a component that is disarmed."""
    return _message(mav.HEARTBEAT_ID, 0, vehicle_type, autopilot, 0, state, 3)


def raw_imu(boot_us: int, acc_m_s2: Vec3, gyr_rad_s: Vec3, mag_gauss: Vec3) -> Message:
    """RAW_IMU in whole mg, mrad/s and mGauss, rounded to the nearest; too large values saturate."""
    acc = [_int16(each * _MG) for each in acc_m_s2]
    gyr_mag = [_int16(each * 1000.0) for each in gyr_rad_s + mag_gauss]
    return _message(mav.RAW_IMU_ID, boot_us, *acc, *gyr_mag, 0, 0)


def attitude(boot_us: int, euler_rad: Vec3, rate_rad_s: Vec3) -> Message:
    """ATTITUDE: roll, pitch, yaw (rad) and the body rates."""
    return _message(mav.ATTITUDE_ID, _boot_ms(boot_us), *euler_rad, *rate_rad_s)


def attitude_quaternion(boot_us: int, q_ned_frd: Quaternion, rate_rad_s: Vec3) -> Message:
    """ATTITUDE_QUATERNION, w first, without an offset."""
    numbers, no_offset = (*q_ned_frd, *rate_rad_s), (0, 0, 0, 0)
    return _message(mav.ATTITUDE_QUATERNION_ID, _boot_ms(boot_us), *numbers, *no_offset)


def attitude_quaternion_cov(
    boot_us: int, q_ned_frd: Quaternion, rate_rad_s: Vec3, variances_rad2: Vec3
) -> Message:
    """ATTITUDE_QUATERNION_COV, w first, with the variances of roll, pitch and yaw.

    https://mavlink.io/en/messages/common.html#ATTITUDE_QUATERNION_COV
    """
    roll, pitch, yaw = variances_rad2
    rows = (roll, 0.0, 0.0, 0.0, pitch, 0.0, 0.0, 0.0, yaw)
    return _message(mav.ATTITUDE_QUATERNION_COV_ID, boot_us, *q_ned_frd, *rate_rad_s, *rows)


def sim_state(
    q_ned_frd: Quaternion,
    euler_rad: Vec3,
    acc_m_s2: Vec3,
    rate_rad_s: Vec3,
    place: Vec3 = ZERO_VEC3,
    velocity_ned_m_s: Vec3 = ZERO_VEC3,
) -> Message:
    """SIM_STATE: true attitude, specific force and rate, place (deg, deg, m) and velocity."""
    degrees_1e7 = [round(degrees * 1e7) for degrees in place[:2]]
    motion, where = (*q_ned_frd, *euler_rad, *acc_m_s2, *rate_rad_s), (*place, 0.0, 0.0)
    return _message(mav.SIM_STATE_ID, *motion, *where, *velocity_ned_m_s, *degrees_1e7)


def global_position(boot_us: int, place: Vec3, height_m: float, velocity_ned_m_s: Vec3) -> Message:
    """GLOBAL_POSITION_INT: place (deg, deg, m), height above the start, velocity in whole cm/s."""
    latitude_deg, longitude_deg, altitude_m = place
    return _message(
        mav.GLOBAL_POSITION_INT_ID,
        _boot_ms(boot_us),
        round(latitude_deg * 1e7),
        round(longitude_deg * 1e7),
        round(altitude_m * 1e3),
        round(height_m * 1e3),
        *(_int16(v * 100.0) for v in velocity_ned_m_s),
        mav.UNKNOWN_UINT16,  # the heading
    )


def autopilot_version(product: str, variant: str) -> Message:
    """AUTOPILOT_VERSION with two names of at most 8 letters in place of commits."""
    names = product.encode().ljust(8, b"\0") + variant.encode().ljust(8, b"\0")
    no_more = bytes(8 + 18)  # the operating system's commit, and a long serial number
    numbers = (mav.MAV_PROTOCOL_CAPABILITY_MAVLINK2, *(7 * (0,)))
    return _message(mav.AUTOPILOT_VERSION_ID, *numbers, *names, *no_more)


def statustexts(text: str, severity: int, number: int) -> list[Message]:
    """STATUSTEXTs of so many characters as need be; ``number`` (not 0) shows that parts are one.

    A zero ends the last part. Source: https://mavlink.io/en/messages/common.html#STATUSTEXT
    """
    letters = text.encode("ascii", "replace")
    if len(letters) <= STATUSTEXT_SIZE:
        return [_message(mav.STATUSTEXT_ID, severity, letters, 0, 0)]
    starts = range(0, len(letters) + 1, STATUSTEXT_SIZE)
    parts = enumerate(letters[start : start + STATUSTEXT_SIZE] for start in starts)
    return [_message(mav.STATUSTEXT_ID, severity, part, number, place) for place, part in parts]


def param_value(name: str, value: float, count: int, index: int) -> Message:
    """PARAM_VALUE as REAL32; the name has at most 16 letters."""
    kind = mav.MAV_PARAM_TYPE_REAL32
    return _message(mav.PARAM_VALUE_ID, value, count, index, name.encode(), kind)


def command_ack(target: VehicleId, command: int, result: int) -> Message:
    """COMMAND_ACK with a MAV_RESULT."""
    return _message(mav.COMMAND_ACK_ID, command, result, 0, 0, *target)


def message_interval_request(
    target: VehicleId, message_id: int, interval_us: float, confirmation: int = 0
) -> Message:
    """COMMAND_LONG that asks for a message every ``interval_us``."""
    parameters = (message_id, interval_us, *(5 * (0.0,)))
    command = mav.MAV_CMD_SET_MESSAGE_INTERVAL
    return _message(mav.COMMAND_LONG_ID, *parameters, command, *target, confirmation)


def signing_key(content: bytes) -> bytes:
    """The key in a key file: 32 raw bytes, 64 hexadecimal digits, or a pass phrase.

    Of a pass phrase the key is its SHA-256, as in MAVProxy and ground stations.
    """
    if len(content) == 32:
        return content
    text = content.strip()
    return hashlib.sha256(text).digest() if is_phrase(content) else bytes.fromhex(text.decode())


def is_phrase(content: bytes) -> bool:
    """Whether a key file holds a pass phrase."""
    return len(content) != 32 and not HEX_KEY.fullmatch(content.strip())


def _int16(value: float) -> int:
    """Without the digits behind the point, as autopilots make whole numbers of their readings.

    A number that is whole but for its last bits stays what it is.
    """
    return max(-32768, min(32767, int(value + copysign(LAST_BITS, value))))


def _boot_ms(boot_us: int) -> int:
    return boot_us // 1000 & 0xFFFFFFFF
