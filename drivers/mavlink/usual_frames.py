"""The frames that nearly all of a stream are, read many at a time by compiled code.

IMU messages that :mod:`drivers.samples.going_on` takes, the autopilot's velocity, and where nobody
shows them ATTITUDE, and other attitudes while they are not wanted.
Whatever else comes is the decoder's, in Python: what is known of its sender is handed back before,
and taken over again behind it.
"""

from collections.abc import Container, Iterable

import numpy as np

from drivers.mavlink.constants import (
    AHRS2_ID,
    ATTITUDE_ID,
    ATTITUDE_QUATERNION_ID,
    AUTOPILOT_VERSION_ID,
)
from drivers.mavlink.frame_rows import (
    argument_types,
    read_frames,
)
from drivers.mavlink.framing import (
    ADDRESSES,
)
from drivers.mavlink.imu_messages import (
    IMU_MESSAGES,
    ImuMessage,
    highres_vectors,
    milli_vectors,
)
from drivers.mavlink.readings import (
    Batch,
    Readings,
    _Stream,
)
from drivers.mavlink.usual_kinds import (
    ATTITUDE,
    AUTOPILOT_VERSION,
    HIGHRES,
    IMUS,
    KINDS,
    N_OTHERS,
    OTHER_CLOCKS,
    OTHER_NAMES,
    OTHERS,
    QUATERNION,
    SECOND_ATTITUDE,
)
from drivers.samples.going_on import (
    GOES_ON,
    HEARD,
    NAVIGATION,
    THERE,
    UNKNOWN,
    VERSION,
    Rows,
)
from drivers.samples.intake import Intake
from drivers.samples.vehicle_clock import TimeField
from estimator.compilation.direct import direct


class UsualFrames:
    """Keeps the numbers of the senders whose frames it reads; see :meth:`hand_back`."""

    def __init__(self, senders: int, *, takes_attitude: bool) -> None:
        self._rows = Rows(senders, IMUS, N_OTHERS)
        self._arrays = self._rows.arrays
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
        n = len(batch.frames)
        rows = (np.empty(n, np.int64), np.empty((n, 5), np.int64), np.empty((n, 9)))
        self._turn += 1
        taken, is_to_look = self._read(
            *batch,
            self._left_in,
            self._turn,
            self._kinds,
            self._places,
            self._arrays,
            rows,
        )
        if not taken:
            return None
        if taken < n:
            rows = (rows[0][:taken], rows[1][:taken], rows[2][:taken])
        arrivals_us, whole, numbers = rows
        arrays = (whole, numbers, arrivals_us)
        readings = Readings(self.addresses, self._intakes, self._streams, *arrays, {})
        if is_to_look:
            readings.look()
        return readings

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
