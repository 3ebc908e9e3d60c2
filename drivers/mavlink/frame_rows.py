"""Rows of numbers from the frames that nearly all of a stream are, written by compiled code.

The rows are what :mod:`drivers.samples.going_on` takes, and what the decoder makes of such frames.
"""

from functools import cache
from math import cos, isfinite, sin
from typing import Any

import numpy as np

from drivers.mavlink.constants import (
    GPS_FIX_TYPE_3D_FIX,
    UNKNOWN_UINT16,
)
from drivers.mavlink.framing import (
    CHECKSUM_SIZE,
    HEADER_V1,
    HEADER_V2,
    MAGIC_V1,
    SIGNATURE_SIZE,
    SIGNED_FLAG,
)
from drivers.mavlink.imu_messages import (
    from_milli,
    highres_field,
)
from drivers.mavlink.messages import CENTI, DEGREES_1E7, MILLI
from drivers.mavlink.readings import Batch
from drivers.mavlink.usual_kinds import (
    ARRIVAL,
    ATTITUDE,
    BEGIN,
    FATE,
    FRESH,
    GIVES,
    GLOBAL_POSITION,
    HIGHRES,
    IMUS,
    IS_THERE,
    LONGEST,
    MOVES,
    N_OTHERS,
    NEXT,
    NO_DATA,
    QUATERNION,
    RADIANS,
    RAW,
    READ,
    RECEIVER,
    SCALED,
    SECOND_ATTITUDE,
    SILENT,
    STOP,
    TO_LOOK,
    WHY,
)
from drivers.samples.fix import (
    FILTER_VELOCITY_SIGMA_M_S,
    RECEIVER_VELOCITY_SIGMA_M_S,
)
from drivers.samples.going_on import (
    GIVEN,
    HEARD,
    LAST_IMU,
    NAVIGATION,
    NOTHING,
    REFUSED,
    TAKEN,
    TAKEN_TO_LOOK,
    VERSION,
    Floats,
    Rows,
    Whole,
    take_imu,
    take_other,
)
from drivers.samples.intake import ATTITUDE_EVERY_US, VERSION_EVERY_US
from drivers.samples.navigation import FIX_US, HAS_FIX, believes_place, velocity_doubt
from drivers.samples.vehicle_clock import BOOT_CLOCK, MOST_US, RECEIVERS_CLOCK
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import types_of
from estimator.types import ZERO_VEC3, Vec3

Bytes = Any  # arrays of uint8


@compiled
def read_frames(
    data: Bytes,
    frames: Whole,
    left_in: Whole,
    turn: int,
    kinds: Whole,
    places: Whole,
    rows: Any,
    read: tuple[Whole, Whole, Floats],
) -> tuple[int, bool]:
    """Take the frames that are :data:`WAITING`; of each sender up to the first that is not taken.

    That one is :data:`NEXT` then.

    ``frames`` are the rows of a :class:`Batch`. ``left_in`` has, by address, the last ``turn``
    in which a sender's frame was left. ``kinds`` are by message, ``places`` of senders by address,
    ``rows`` of :class:`Rows`. What is read gets, in order, its arrival, whole numbers (kind, place,
    time, boot time, flags) and others (rate, specific force, field). Returns how many were taken,
    and whether one of them is to be looked at.
    """
    payload = np.zeros(LONGEST, np.uint8)
    views = (payload, payload.view(np.int16), payload.view(np.float32))
    read_us, whole, numbers = read
    n, is_to_look = 0, False
    for k in range(len(frames)):
        if frames[k, FATE] == READ:
            continue
        message, address, begin, end = header_of(data, frames[k, BEGIN], frames[k, STOP])
        if left_in[address] == turn:
            continue
        place = places[address]
        kind = kinds[message] if message < len(kinds) else 0
        is_taken = False
        if kind != 0 and place >= 0:
            unpack(data, begin, end, payload)
            arrival_us = frames[k, ARRIVAL]
            is_taken = read_frame(kind, place, arrival_us, views, rows, whole[n], numbers[n])
        if not is_taken:
            left_in[address], frames[k, FATE] = turn, NEXT
            continue
        frames[k, FATE], read_us[n] = READ, frames[k, ARRIVAL]
        is_to_look = is_to_look or whole[n, 4] & TO_LOOK != 0
        n += 1
    return n, is_to_look


@inlined
def read_frame(
    kind: int, place: int, arrival_us: int, views: Any, rows: Any, whole: Whole, numbers: Floats
) -> bool:
    """Take a frame's payload, if it is that of a reading that just goes on."""
    said, has_clock, has_other = rows[1][place], rows[6], rows[7]
    if not has_clock[place]:
        return False
    is_given = 0 <= arrival_us - said[GIVEN] < ATTITUDE_EVERY_US
    if kind >= QUATERNION:
        if kind == QUATERNION:
            done = is_given
        elif kind == SECOND_ATTITUDE:
            done = has_other[place * N_OTHERS]
        else:
            done = 0 <= arrival_us - said[VERSION] < VERSION_EVERY_US
        kind, time_us, boot_us, flags, vectors = SILENT, 0, 0, 0, (ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
    elif kind >= ATTITUDE:
        boot_us = 0
        if kind == RECEIVER:
            done, time_us, flags, vectors = read_receiver(place, arrival_us, views, rows)
        else:
            done, time_us, flags, vectors = read_other(kind, place, arrival_us, views, rows)
    else:
        done, time_us, boot_us, flags, vectors = read_imu(kind, place, arrival_us, views, rows)
    if done == NOTHING:
        return False
    said[HEARD] = arrival_us
    if kind < ATTITUDE:
        if done != REFUSED:
            said[LAST_IMU] = time_us
    elif kind == ATTITUDE and not is_given:
        said[GIVEN] = arrival_us
        flags |= GIVES
    elif kind != ATTITUDE and flags == 0:
        kind = SILENT
    whole[0], whole[1], whole[2], whole[3], whole[4] = kind, place, time_us, boot_us, flags
    for i in range(3):
        for j in range(3):
            numbers[3 * i + j] = vectors[i][j]
    return True


@inlined
def read_imu(
    kind: int, place: int, arrival_us: int, views: Any, rows: Any
) -> tuple[int, int, int, int, tuple[Vec3, Vec3, Vec3]]:
    """An IMU message: what it has done, continuous and boot time, flags, rate, force and field."""
    payload, words, reals = views
    imu_whole, imu_numbers, has_imu = rows[4], rows[5], rows[8]
    stream = place * IMUS + kind - 1
    raw_us, gyr, acc, mag = imu_of(kind, payload, words, reals)
    vectors = (gyr, acc, mag)
    is_finite = isfinite(sum3(gyr) + sum3(acc) + sum3(mag))
    if raw_us < 0 or not is_finite:
        return NOTHING, 0, 0, 0, vectors
    field = 0 if kind <= HIGHRES else 1
    known = (has_imu[stream], imu_whole[stream], imu_numbers[stream])
    done, why, time_us, boot_us, is_fresh = take_imu(
        rows[0][place], field, known, raw_us, arrival_us, vectors
    )
    flags = (FRESH if is_fresh else 0) | (TO_LOOK if done == TAKEN_TO_LOOK else 0) | why * WHY
    if done == REFUSED:
        flags |= NO_DATA
    return done, time_us, boot_us, flags, vectors


@inlined
def read_other(
    kind: int, place: int, arrival_us: int, views: Any, rows: Any
) -> tuple[int, int, int, tuple[Vec3, Vec3, Vec3]]:
    """A message that is no IMU's: what it has done, continuous time, flags, and three vectors.

    Rates and angles of ATTITUDE; velocity, place and in the third its sigma of the others.
    """
    payload, words, reals = views
    clocks, sayings, doubts, others, has_other = rows[0], rows[1], rows[2], rows[3], rows[7]
    stream, said = place * N_OTHERS + kind - ATTITUDE, sayings[place]
    first, second, third, flags = three_reals(reals, 4), ZERO_VEC3, ZERO_VEC3, 0
    if kind == ATTITUDE:
        second = three_reals(reals, 1)
    elif kind == GLOBAL_POSITION:
        first, second = global_position_of(words, payload.view(np.int32))
        if second[0] == 0.0 and second[1] == 0.0:  # not known yet
            return TAKEN, 0, 0, (first, second, third)
    # as little believed as the angles beside them, rates that are none are somebody else's matter
    judged = sum3(second) if kind == ATTITUDE else sum3(first)
    if not has_other[stream] or not isfinite(judged):
        return NOTHING, 0, 0, (first, second, third)
    raw_us = whole_number(payload.view(np.uint32)[0]) * 1000
    done, time_us = take_other(clocks[place], others[stream], BOOT_CLOCK, raw_us, arrival_us)
    if kind != ATTITUDE:
        doubt = velocity_doubt(said[NAVIGATION:], doubts[place], arrival_us)
        third = (FILTER_VELOCITY_SIGMA_M_S * doubt, 0.0, 0.0)
        flags = MOVES if doubt >= 0.0 else 0
    if kind == GLOBAL_POSITION and believes_place(
        said[NAVIGATION:], second[0], second[1], arrival_us
    ):
        flags |= IS_THERE
    return done, time_us, flags, (first, second, third)


@inlined
def read_receiver(
    place: int, arrival_us: int, views: Any, rows: Any
) -> tuple[int, int, int, tuple[Vec3, Vec3, Vec3]]:
    """GPS_RAW_INT, likewise."""
    payload, words, _ = views
    clocks, said, others, has_other = rows[0], rows[1][place], rows[3], rows[7]
    stream = place * N_OTHERS + RECEIVER - ATTITUDE
    longs, shorts = payload.view(np.int32), words.view(np.uint16)
    where = (longs[2] * DEGREES_1E7, longs[3] * DEGREES_1E7, longs[4] * MILLI)
    speed, course, sigma, flags = shorts[12], shorts[13], RECEIVER_VELOCITY_SIGMA_M_S, 0
    raw_us, has_fix = payload.view(np.int64)[0], payload[28] >= GPS_FIX_TYPE_3D_FIX
    done, time_us, velocity = TAKEN, 0, ZERO_VEC3
    if has_fix and (where[0] != 0.0 or where[1] != 0.0):
        if not has_other[stream] or not 0 <= raw_us <= MOST_US:
            return NOTHING, 0, 0, (ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
        done, time_us = take_other(
            clocks[place], others[stream], RECEIVERS_CLOCK, raw_us, arrival_us
        )
        flags = IS_THERE
        if max(speed, course) < UNKNOWN_UINT16:
            flags |= MOVES
            speed_m_s, course_rad = speed * CENTI, (course * CENTI) * RADIANS
            velocity = (speed_m_s * cos(course_rad), speed_m_s * sin(course_rad), 0.0)
        accuracy = whole_number(shorts[21]) | whole_number(shorts[22]) << 16
        if accuracy != 0:
            sigma = accuracy * MILLI
    if done != NOTHING:
        said[NAVIGATION + FIX_US] = arrival_us
        said[NAVIGATION + HAS_FIX] = 1 if has_fix else 0
    return done, time_us, flags, (velocity, where, (sigma, 0.0, 0.0))


@inlined
def header_of(data: Bytes, begin: int, end: int) -> tuple[int, int, int, int]:
    """Message and address of a whole frame, its payload's begin and end."""
    if data[begin] == MAGIC_V1:
        message, sender, at, last = whole_number(data[begin + 5]), begin + 3, begin + HEADER_V1, end
    else:
        high = whole_number(data[begin + 8]) << 8 | whole_number(data[begin + 9]) << 16
        message, sender = whole_number(data[begin + 7]) | high, begin + 5
        at = begin + HEADER_V2
        last = end - (SIGNATURE_SIZE if data[begin + 2] & SIGNED_FLAG else 0)
    address = whole_number(data[sender]) << 8 | whole_number(data[sender + 1])
    return message, address, at, last - CHECKSUM_SIZE


@inlined
def unpack(data: Bytes, begin: int, end: int, payload: Bytes) -> None:
    """Write a payload, with the zeros that were not sent."""
    size = min(end - begin, LONGEST)
    for i in range(LONGEST):
        payload[i] = data[begin + i] if i < size else 0


@inlined
def imu_of(kind: int, payload: Bytes, words: Any, reals: Any) -> tuple[int, Vec3, Vec3, Vec3]:
    """Time (us, negative if it is another IMU's) and vectors of an IMU message."""
    if kind >= SCALED:
        raw_us = whole_number(payload.view(np.uint32)[0]) * 1000
        gyr, acc, mag = from_milli(*three_cuts(words, 2))
        return raw_us, gyr, acc, mag
    raw_us = payload.view(np.int64)[0]
    if raw_us > MOST_US or payload[62 if kind == HIGHRES else 26] != 0:
        raw_us = whole_number(-1)
    if kind == RAW:
        gyr, acc, mag = from_milli(*three_cuts(words, 4))
        return raw_us, gyr, acc, mag
    field = highres_field(three_reals(reals, 8), payload.view(np.uint16)[30])
    return raw_us, three_reals(reals, 5), three_reals(reals, 2), field


@inlined
def global_position_of(words: Any, longs: Any) -> tuple[Vec3, Vec3]:
    """Velocity (m/s, NED) and place (degrees, m) of GLOBAL_POSITION_INT."""
    velocity = (words[10] * CENTI, words[11] * CENTI, words[12] * CENTI)
    return velocity, (longs[1] * DEGREES_1E7, longs[2] * DEGREES_1E7, longs[3] * MILLI)


@inlined
def three_cuts(words: Any, at: int) -> Any:
    """Rate, force and field of a message in which force, rate and field follow each other."""
    acc = (words[at], words[at + 1], words[at + 2])
    gyr = (words[at + 3], words[at + 4], words[at + 5])
    return gyr, acc, (words[at + 6], words[at + 7], words[at + 8])


@inlined
def three_reals(reals: Any, at: int) -> Vec3:
    """A vector."""
    return (np.float64(reals[at]), np.float64(reals[at + 1]), np.float64(reals[at + 2]))


@inlined
def whole_number(value: Any) -> Any:
    """As all whole numbers are here, whatever their size in a message."""
    return np.int64(value)


@inlined
def sum3(v: Vec3) -> float:
    """The sum of a vector's parts, which is finite only if they are."""
    return v[0] + v[1] + v[2]


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`read_frames` is called with."""
    rows, whole = Rows(0, 0, 0).arrays, np.zeros(0, np.int64)
    read = (whole, np.zeros((0, 5), np.int64), np.zeros((0, 9)))
    return types_of(*Batch.of([]), whole, 0, whole, whole, rows, read)
