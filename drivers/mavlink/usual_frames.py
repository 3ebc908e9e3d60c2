"""The frames that nearly all of a stream are, read many at a time by compiled code.

IMU messages that :mod:`drivers.samples.going_on` takes, the autopilot's velocity, and where nobody
shows them ATTITUDE, and other attitudes while they are not wanted.
Whatever else comes is the decoder's, in Python: what is known of its sender is handed back before,
and taken over again behind it.
"""

from collections.abc import Container, Iterable, Sequence
from functools import cache
from math import cos, isfinite, pi, sin
from typing import Any, NamedTuple, Self

import numba
import numpy as np

from drivers.events import (
    BodyRates,
    Event,
    Imu,
    Position,
    ReferenceAttitude,
    Rejected,
    VehicleId,
    Velocity,
)
from drivers.mavlink.backlog import Arrived
from drivers.mavlink.constants import (
    AHRS2_ID,
    ATTITUDE_ID,
    ATTITUDE_QUATERNION_ID,
    AUTOPILOT_VERSION_ID,
    GLOBAL_POSITION_INT_ID,
    GPS_FIX_TYPE_3D_FIX,
    GPS_RAW_INT_ID,
    HIGHRES_IMU_ID,
    LOCAL_POSITION_NED_ID,
    RAW_IMU_ID,
    SCALED_IMU2_ID,
    SCALED_IMU3_ID,
    SCALED_IMU_ID,
    UNKNOWN_UINT16,
)
from drivers.mavlink.framing import (
    ADDRESSES,
    CHECKSUM_SIZE,
    HEADER_V1,
    HEADER_V2,
    MAGIC_V1,
    SIGNATURE_SIZE,
    SIGNED_FLAG,
)
from drivers.mavlink.imu_messages import (
    IMU_MESSAGES,
    ImuMessage,
    from_milli,
    highres_field,
    highres_vectors,
    milli_vectors,
)
from drivers.mavlink.messages import CENTI, DEGREES_1E7, MESSAGES, MILLI
from drivers.samples.fix import (
    FILTER_VELOCITY_SIGMA_M_S,
    RECEIVER_LATE_SIGMA_S,
    RECEIVER_VELOCITY_SIGMA_M_S,
)
from drivers.samples.going_on import (
    GIVEN,
    GOES_ON,
    HEARD,
    LAST_IMU,
    NAVIGATION,
    NOTHING,
    REFUSED,
    TAKEN,
    TAKEN_TO_LOOK,
    THERE,
    UNKNOWN,
    VERSION,
    Floats,
    Rows,
    Whole,
    take_imu,
    take_other,
)
from drivers.samples.intake import ATTITUDE_EVERY_US, VERSION_EVERY_US, Intake
from drivers.samples.navigation import FIX_US, HAS_FIX, believes_place, velocity_doubt
from drivers.samples.rotation import quaternion_from_euler
from drivers.samples.sensor_faults import REASONS
from drivers.samples.vehicle_clock import BOOT_CLOCK, MOST_US, RECEIVERS_CLOCK, TimeField
from estimator.compilation.compiled import compiled, inlined
from estimator.compilation.direct import direct
from estimator.types import ZERO_VEC3, ImuSample, RateSample, Vec3, VelocitySample

Bytes = Any  # arrays of uint8

# What a message is to compiled code; 0 is nothing.
# They are in the order of preference.
RAW, HIGHRES, SCALED = 1, 2, 3  # the latter of three messages
KINDS = {
    RAW_IMU_ID: RAW,
    HIGHRES_IMU_ID: HIGHRES,
    SCALED_IMU_ID: SCALED,
    SCALED_IMU2_ID: SCALED + 1,
    SCALED_IMU3_ID: SCALED + 2,
}
KIND_NAMES = {kind: IMU_MESSAGES[number].name for number, kind in KINDS.items()}
KIND_OF = {name: kind for kind, name in KIND_NAMES.items()}
IMUS = len(KINDS)
ATTITUDE, LOCAL_POSITION, GLOBAL_POSITION, RECEIVER = IMUS + 1, IMUS + 2, IMUS + 3, IMUS + 4
# Attitudes without rates where they are not wanted, and what says nothing.
QUATERNION, SECOND_ATTITUDE, AUTOPILOT_VERSION, SILENT = IMUS + 5, IMUS + 6, IMUS + 7, IMUS + 8
# Other streams that have a time, in the order of their kinds.
OTHERS = {
    ATTITUDE: ATTITUDE_ID,
    LOCAL_POSITION: LOCAL_POSITION_NED_ID,
    GLOBAL_POSITION: GLOBAL_POSITION_INT_ID,
    RECEIVER: GPS_RAW_INT_ID,
}
OTHER_CLOCKS = {kind: TimeField.GPS if kind == RECEIVER else TimeField.BOOT_MS for kind in OTHERS}
OTHER_NAMES = {kind: MESSAGES[number].name for kind, number in OTHERS.items()}
OTHER_OF = {name: kind for kind, name in OTHER_NAMES.items()}
ATTITUDE_NAME = OTHER_NAMES[ATTITUDE]
N_OTHERS = len(OTHERS)
# Of a payload; what follows is of no interest here.
LONGEST = 64
RADIANS = pi / 180.0
# Flags: a fresh field, a sample to be looked at, an attitude that is wanted, a velocity, a place, a
# reading that is no data; times WHY the reason for that, or why the field is none.
FRESH, TO_LOOK, GIVES, MOVES, IS_THERE, NO_DATA, WHY = 1, 2, 4, 8, 16, 32, 64
# What has become of a frame.
READ, WAITING, NEXT = 0, 1, 2

_typeof: Any = numba.typeof  # numba ships no types


@compiled
def read_frames(
    data: Bytes,
    bounds: Whole,
    arrivals_us: Whole,
    waiting: Whole,
    left_in: Whole,
    turn: int,
    kinds: Whole,
    places: Whole,
    rows: Any,
    read: tuple[Whole, Whole, Floats],
) -> int:
    """Take the frames that are :data:`WAITING`; of each sender up to the first that is not taken.

    That one is :data:`NEXT` then.

    Frame k is ``data[bounds[k, 0]:bounds[k, 1]]``. ``left_in`` has, by address, the last ``turn``
    in which a sender's frame was left. ``kinds`` are by message, ``places`` of senders by address,
    ``rows`` of :class:`Rows`. What is read gets, in order, its arrival, whole numbers (kind, place,
    time, boot time, flags) and others (rate, specific force, field). Returns how many were taken.
    """
    payload = np.zeros(LONGEST, np.uint8)
    views = (payload, payload.view(np.int16), payload.view(np.float32))
    read_us, whole, numbers = read
    n = 0
    for k in range(len(arrivals_us)):
        if waiting[k] == READ:
            continue
        message, address, begin, end = header_of(data, bounds[k, 0], bounds[k, 1])
        if left_in[address] == turn:
            continue
        place = places[address]
        kind = kinds[message] if message < len(kinds) else 0
        is_taken = False
        if kind != 0 and place >= 0:
            unpack(data, begin, end, payload)
            is_taken = read_frame(kind, place, arrivals_us[k], views, rows, whole[n], numbers[n])
        if not is_taken:
            left_in[address], waiting[k] = turn, NEXT
            continue
        waiting[k], read_us[n] = READ, arrivals_us[k]
        n += 1
    return n


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


class _Stream(NamedTuple):
    """An IMU message's name and clock."""

    name: str
    clock: TimeField


class Batch:
    """Frames as compiled code takes them; some of them may still be waiting."""

    def __init__(self, data: Bytes, bounds: Whole, arrivals_us: Whole) -> None:
        n = len(arrivals_us)
        self.data = data
        self.bounds = bounds
        self.arrivals_us = arrivals_us
        self.waiting = np.full(n, WAITING, np.int64)

    @classmethod
    def of(cls, arrived: Sequence[Arrived]) -> Self:
        """The batch of these frames."""
        frames = [each.frame.data for each in arrived]
        ends = np.cumsum(np.fromiter(map(len, frames), np.int64, len(frames)))
        bounds = np.zeros((len(frames), 2), np.int64)
        bounds[1:, 0], bounds[:, 1] = ends[:-1], ends
        arrivals_us = np.array([each.arrival_us for each in arrived], np.int64)
        return cls(np.frombuffer(b"".join(frames), np.uint8), bounds, arrivals_us)


def _attitude(vehicle: VehicleId, arrival_us: int, time_us: int, angles: Vec3) -> list[Event]:
    """The autopilot's own attitude, of roll, pitch and yaw (rad)."""
    q = quaternion_from_euler(*angles)
    assert q is not None  # they are finite
    return [ReferenceAttitude(vehicle, arrival_us, time_us, "autopilot", ATTITUDE_NAME, q)]


def _fix(
    vehicle: VehicleId,
    arrival_us: int,
    kind: int,
    time_us: int,
    numbers: tuple[float, ...],
    flags: int,
) -> list[Event]:
    """What a message says of place and velocity, as far as it is believed."""
    name, events = OTHER_NAMES[kind], list[Event]()
    if flags & IS_THERE:
        events.append(Position(vehicle, arrival_us, time_us, name, *numbers[3:6]))
    if flags & MOVES:
        x, y, z = numbers[:3]
        late_sigma_s = RECEIVER_LATE_SIGMA_S if kind == RECEIVER else 0.0
        sample = VelocitySample(time_us, (x, y, z), kind != RECEIVER, numbers[6], late_sigma_s)
        events.append(Velocity(vehicle, arrival_us, name, sample))
    return events


class Readings:
    """Rows that :func:`read_frames` has written: what nearly all frames of a batch say.

    ``addresses`` of senders are by place.
    """

    def __init__(
        self,
        addresses: Whole,
        intakes: list[Intake | None],
        streams: dict[int, _Stream],
        whole: Whole,
        numbers: Floats,
        arrivals_us: Whole,
    ) -> None:
        self.addresses = addresses
        self.whole = whole
        self.numbers = numbers
        self.arrivals_us = arrivals_us
        self._intakes = intakes
        self._streams = streams
        # at once, before anybody else looks at what comes behind these
        looks = (whole[:, 4] & TO_LOOK).nonzero()[0].tolist()
        self._complaints = {k: self._look(k) for k in looks}

    def __len__(self) -> int:
        return len(self.arrivals_us)

    def events(self, rows: Sequence[int] | None = None) -> list[Event]:
        """The events of those rows, or of all, in order."""
        events: list[Event] = []
        if rows is not None and not rows:  # nearly always
            return events
        which = range(len(self)) if rows is None else rows
        whole, arrivals_us = self.whole[which].tolist(), self.arrivals_us[which].tolist()
        vectors = map(tuple, self.numbers[which].tolist())
        for k, row, numbers, arrival_us in zip(which, whole, vectors, arrivals_us, strict=True):
            kind, place, time_us, boot_us, flags = row
            intake = self._intakes[place]
            assert intake is not None
            if kind == SILENT:
                continue
            if kind > ATTITUDE:
                events += _fix(intake.vehicle, arrival_us, kind, time_us, numbers, flags)
                continue
            if kind == ATTITUDE:
                if flags & GIVES:
                    events += _attitude(intake.vehicle, arrival_us, time_us, numbers[3:6])
                rates = RateSample(time_us, numbers[:3])
                events.append(BodyRates(intake.vehicle, arrival_us, ATTITUDE_NAME, rates))
                continue
            name, sample = self._streams[kind].name, _sample(time_us, numbers, flags)
            reason = REASONS[flags // WHY]
            if reason is not None:
                events.append(Rejected(intake.vehicle, arrival_us, reason, name))
            if flags & NO_DATA:
                continue
            events.append(Imu(intake.vehicle, arrival_us, boot_us, name, sample))
            events += self._complaints.get(k, [])
        return events

    def looks(self, rows: Iterable[int]) -> list[Event]:
        """Complaints about samples of those rows that were to be looked at."""
        return [event for k in rows for event in self._complaints.get(k, [])]

    def _look(self, k: int) -> list[Event]:
        kind, place, time_us, _, flags = self.whole[k].tolist()
        intake, numbers = self._intakes[place], tuple(self.numbers[k].tolist())
        assert intake is not None
        sample = _sample(time_us, numbers, flags)
        complaints: list[Event] = intake.look(
            self._streams[kind].name, int(self.arrivals_us[k]), sample
        )
        return complaints


def events_of(found: Sequence[Event | Readings]) -> list[Event]:
    """All as events."""
    events: list[Event] = []
    for each in found:
        events += each.events() if isinstance(each, Readings) else [each]
    return events


def _sample(time_us: int, numbers: tuple[float, ...], flags: int) -> ImuSample:
    is_fresh = flags & FRESH != 0
    mag = numbers[6:] if is_fresh else ZERO_VEC3
    return ImuSample._make((time_us, numbers[:3], numbers[3:6], mag, is_fresh))


class UsualFrames:
    """Keeps the numbers of the senders whose frames it reads; see :meth:`hand_back`."""

    def __init__(self, senders: int, *, takes_attitude: bool) -> None:
        self._rows = Rows(senders, IMUS, N_OTHERS)
        self._kinds = np.zeros(256, np.int64)
        self._streams: dict[int, _Stream] = {}
        for number, message in IMU_MESSAGES.items():
            if _is_ours(message):
                self._kinds[number] = KINDS[number]
                self._streams[KINDS[number]] = _Stream(message.name, message.clock)
        for kind, number in OTHERS.items():
            self._kinds[number] = kind
        self._kinds[AUTOPILOT_VERSION_ID] = AUTOPILOT_VERSION
        unwanted = {ATTITUDE_QUATERNION_ID: QUATERNION, AHRS2_ID: SECOND_ATTITUDE}
        for number, kind in unwanted.items():
            self._kinds[number] = kind if takes_attitude else 0
        self._kinds[ATTITUDE_ID] *= takes_attitude
        self._places = np.full(ADDRESSES, -1, np.int64)
        self.addresses = np.zeros(senders, np.int64)  # by place
        self._intakes: list[Intake | None] = [None] * senders
        self._free = list(range(senders - 1, -1, -1))
        self._left_in = np.zeros(ADDRESSES, np.int64)
        self._turn = 0
        self._read = direct(read_frames, argument_types())

    def read(self, batch: Batch) -> "Readings | None":
        """Of each sender's frames that are waiting, those before the first unusual one."""
        n = len(batch.arrivals_us)
        rows = (np.empty(n, np.int64), np.empty((n, 5), np.int64), np.empty((n, 9)))
        self._turn += 1
        taken: int = self._read(
            batch.data,
            batch.bounds,
            batch.arrivals_us,
            batch.waiting,
            self._left_in,
            self._turn,
            self._kinds,
            self._places,
            self._rows.arrays,
            rows,
        )
        if not taken:
            return None
        arrivals_us, whole, numbers = (each[:taken] for each in rows)
        arrays = (whole, numbers, arrivals_us)
        return Readings(self.addresses, self._intakes, self._streams, *arrays)

    def hand_back(self, intake: Intake, message_id: int | None = None) -> None:
        """Give an intake its numbers back, before anybody else uses it.

        Of its IMU streams, which do not know each other, only that of a message, if one is named.
        """
        place = self._place(intake)
        if place < 0:
            return
        rows = self._rows
        if rows.has_clock[place]:
            self.tell_words(intake)
            rows.has_clock[place] = False
            intake.clock.whole[:] = rows.clocks[place]
            said = rows.said[place, :NAVIGATION].tolist()
            intake.attitude_given_us, intake.version_given_us, heard_us, intake.last_imu_us = said
            intake.heard_us = max(intake.heard_us, heard_us)
            for kind, name in OTHER_NAMES.items():
                at = place * N_OTHERS + kind - ATTITUDE
                if rows.has_other[at]:
                    rows.has_other[at] = False
                    intake.clock.resume_after(name, OTHER_CLOCKS[kind], *rows.others[at].tolist())
        for kind in self._kinds_of(message_id):
            self._hand_back_stream(intake, place, kind)

    def _kinds_of(self, message_id: int | None) -> Iterable[int]:
        """Of a message that is an IMU's; of all of them if none is named."""
        kind = KINDS.get(message_id, 0)  # type: ignore[arg-type]
        return self._streams if message_id is None else {kind} & self._streams.keys()

    def _hand_back_stream(
        self, intake: Intake, place: int, kind: int, forgotten: Container[TimeField] = ()
    ) -> None:
        """Also to what the intake's clock has forgotten meanwhile."""
        rows, at = self._rows, place * IMUS + kind - 1
        if rows.has_imu[at] == GOES_ON:
            rows.has_imu[at] = THERE
            stream, numbers = self._streams[kind], rows.numbers[at].tolist()
            whole = rows.whole[at].tolist()
            is_placed = stream.clock not in forgotten
            intake.resume_imu(stream.name, stream.clock, whole, numbers, is_placed=is_placed)

    def heard_us(self, intake: Intake) -> int:
        """When one intake was heard last."""
        place = self._place(intake)
        return max(intake.heard_us, int(self._rows.said[place, HEARD]) if place >= 0 else 0)

    def note_heard(self) -> None:
        """Have all intakes know when they were heard last."""
        for intake, heard_us in zip(self._intakes, self._rows.said[:, HEARD].tolist(), strict=True):
            if intake is not None:
                intake.heard_us = max(intake.heard_us, heard_us)

    def take_over(self, intake: Intake, message_id: int | None = None) -> None:
        """Take an intake's numbers, as far as its streams just go on; behind :meth:`hand_back`."""
        rows, place = self._rows, self._place(intake)
        forgotten = intake.clock.take_forgotten()
        kinds = self._kinds_of(None if forgotten else message_id)
        if forgotten and place >= 0:
            for kind in kinds:
                self._hand_back_stream(intake, place, kind, forgotten)
        if place < 0:
            if not intake.clock.has_line:
                return
            place = self._free.pop()
            self._places[_address(intake)] = place
            self._intakes[place], self.addresses[place] = intake, _address(intake)
        for kind in kinds:
            stream, at = self._streams[kind], place * IMUS + kind - 1
            numbers = intake.imu_numbers(stream.name, stream.clock)
            rows.has_imu[at] = THERE if intake.has_stream(stream.name) else UNKNOWN
            if numbers is not None:
                rows.has_imu[at] = GOES_ON
                rows.whole[at], rows.numbers[at] = numbers
        if not (rows.has_imu[place * IMUS : (place + 1) * IMUS] == GOES_ON).any():
            return
        rows.has_clock[place] = True
        rows.clocks[place] = intake.clock.whole
        assert intake.last_imu_us is not None  # it has a stream
        given_us = intake.attitude_given_us, intake.version_given_us
        rows.said[place, :NAVIGATION] = *given_us, intake.heard_us, intake.last_imu_us
        self.note_words(intake)
        for kind, name in OTHER_NAMES.items():
            at = place * N_OTHERS + kind - ATTITUDE
            placed = intake.clock.last_placed(name, OTHER_CLOCKS[kind])
            if placed is not None:
                rows.has_other[at], rows.others[at] = True, placed

    def tell_words(self, intake: Intake) -> None:
        """Have a vehicle know what its filter and receiver have said of themselves."""
        place = self._place(intake)
        if place >= 0 and self._rows.has_clock[place]:
            intake.navigation.words[:] = self._rows.said[place, NAVIGATION:].tolist()

    def note_version(self, intake: Intake) -> None:
        """Know that it was looked into what vehicle it is."""
        place = self._place(intake)
        if place >= 0:
            self._rows.said[place, VERSION] = intake.version_given_us

    def note_words(self, intake: Intake) -> None:
        """Know what a vehicle's filter and receiver have said of themselves."""
        place, navigation = self._place(intake), intake.navigation
        if place >= 0:
            self._rows.said[place, NAVIGATION:] = navigation.words
            self._rows.doubts[place] = navigation.doubt

    def forget(self, intake: Intake) -> None:
        """A sender is gone."""
        place = self._place(intake)
        if place >= 0:
            self.hand_back(intake)
            self._places[_address(intake)] = -1
            self._rows.has_imu[place * IMUS : (place + 1) * IMUS] = UNKNOWN
            self._intakes[place] = None
            self._free.append(place)

    def _place(self, intake: Intake) -> int:
        return int(self._places[_address(intake)])


@cache
def argument_types() -> tuple[Any, ...]:
    """What numba calls the types that :func:`read_frames` is called with."""
    batch, rows, whole = Batch.of([]), Rows(0, 0, 0).arrays, np.zeros(0, np.int64)
    read = (whole, np.zeros((0, 5), np.int64), np.zeros((0, 9)))
    frames = (batch.data, batch.bounds, batch.arrivals_us, batch.waiting)
    return tuple(map(_typeof, (*frames, whole, 0, whole, whole, rows, read)))


def _address(intake: Intake) -> int:
    return intake.vehicle.system_id << 8 | intake.vehicle.component_id


def _is_ours(message: ImuMessage) -> bool:
    """Whether the table says of a message what compiled code knows of it."""
    kind = KINDS.get(message.number)
    if kind is None:
        return False
    vectors = highres_vectors if kind == HIGHRES else milli_vectors
    clock = TimeField(0 if kind <= HIGHRES else 1)
    return message.vectors is vectors and message.clock is clock
