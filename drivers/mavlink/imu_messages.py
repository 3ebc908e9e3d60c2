"""The table of IMU messages: one entry holds everything that is known of a message.

Decoder, backlog, choice among several messages, requests for a rate and the advice about logs
without IMU data ask this table. A further message is one more entry.
"""

from collections.abc import Callable
from functools import cache
from struct import calcsize
from typing import Any, NamedTuple

from drivers.mavlink import constants as mav
from drivers.mavlink.framing import Frame, layout
from drivers.samples.vehicle_clock import TimeField
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

MG_M_S2 = STANDARD_GRAVITY_M_S2 / 1000.0
MILLI = 1e-3
GAUSS_LIMIT = 20.0  # the Earth's field is 0.25..0.65 gauss; more is another unit
MILLIGAUSS_LIMIT = 20_000.0

Vectors = tuple[Vec3, Vec3, Vec3]


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
    """The vectors of HIGHRES_IMU: rad/s, m/s^2, gauss; a field that was not updated is zero."""
    mag = _highres_field((m.xmag, m.ymag, m.zmag), m.fields_updated)
    return (m.xgyro, m.ygyro, m.zgyro), (m.xacc, m.yacc, m.zacc), mag


def _highres_field(mag: Vec3, updated: int) -> Vec3:
    """The field of HIGHRES_IMU by its bits of what was updated, gauss.

    ArduPilot's was 10^6 too large until early 2026; others send mGauss.
    """
    if updated and not updated & mav.HIGHRES_IMU_UPDATED_MAG:
        return ZERO_VEC3
    largest = max(abs(mag[0]), abs(mag[1]), abs(mag[2]))
    if largest > MILLIGAUSS_LIMIT:
        return (mag[0] * 1e-6, mag[1] * 1e-6, mag[2] * 1e-6)
    if largest > GAUSS_LIMIT:
        return (mag[0] * 1e-3, mag[1] * 1e-3, mag[2] * 1e-3)
    return mag


class ImuMessage(NamedTuple):
    """One IMU message of pymavlink's ardupilotmega dialect.

    ``clock`` says what its time is: TIME_USEC of a field ``time_usec``, BOOT_MS of a field
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
        ImuMessage(
            mav.RAW_IMU_ID,
            "RAW_IMU",
            TimeField.TIME_USEC,
            milli_vectors,
            setting="SR*_RAW_SENS = 50",
        ),
        ImuMessage(
            mav.HIGHRES_IMU_ID,
            "HIGHRES_IMU",
            TimeField.TIME_USEC,
            highres_vectors,
            asked_of=(mav.MAV_AUTOPILOT_PX4,),
            setting="mavlink stream -r 50 -s HIGHRES_IMU",
        ),
        ImuMessage(mav.SCALED_IMU_ID, "SCALED_IMU", TimeField.BOOT_MS, milli_vectors),
        ImuMessage(mav.SCALED_IMU2_ID, "SCALED_IMU2", TimeField.BOOT_MS, milli_vectors),
        ImuMessage(mav.SCALED_IMU3_ID, "SCALED_IMU3", TimeField.BOOT_MS, milli_vectors),
    )
}


def imu_rank(message: str) -> int:
    """Place of an IMU message in the order of preference; names that only logs use come last."""
    for place, each in enumerate(IMU_MESSAGES.values()):
        if each.name == message:
            return place
    return len(IMU_MESSAGES)


def message_to_ask_for(autopilot: int | None) -> ImuMessage:
    """The message to request from a vehicle of that MAV_AUTOPILOT; RAW_IMU where no entry fits."""
    asked = (each for each in IMU_MESSAGES.values() if autopilot in each.asked_of)
    return next(asked, IMU_MESSAGES[mav.RAW_IMU_ID])


def imu_stream_name(name: str, number: int) -> str:
    """The message's name; a second IMU in the same message (field ``id``) is another stream."""
    return f"{name}:{number}" if number else name


def has_imu_number(message_id: int) -> bool:
    """Whether a message says in its field ``id`` which of the vehicle's IMUs it comes from."""
    return number_at(message_id) is not None


def imu_number(frame: Frame) -> int:
    """The number of the vehicle's IMU that the frame shows in its field ``id``, or 0."""
    if frame.message_id not in IMU_MESSAGES:
        return 0
    at = number_at(frame.message_id)
    if at is None:
        return 0
    at += frame.payload_at
    return frame.data[at] if at < frame.payload_end else 0


@cache
def number_at(message_id: int) -> int | None:
    """Where the field ``id`` stands in the payload; None if the message has none, or has arrays."""
    known = layout(message_id)
    if known is None or "id" not in known.names:
        return None
    codes = known.struct.format.lstrip("<")
    return calcsize("<" + codes[: known.names.index("id")])
