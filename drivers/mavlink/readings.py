"""Batches of frames for compiled code, and the rows that it has written as events."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Self

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
from drivers.mavlink.usual_kinds import (
    ARRIVAL,
    ATTITUDE,
    ATTITUDE_NAME,
    BATCH_COLUMNS,
    BEGIN,
    FATE,
    FRESH,
    GIVES,
    IS_THERE,
    MOVES,
    NO_DATA,
    NUMBER,
    OTHER_NAMES,
    RECEIVER,
    SILENT,
    STOP,
    TO_LOOK,
    WAITING,
    WHY,
)
from drivers.samples.fix import (
    RECEIVER_LATE_SIGMA_S,
)
from drivers.samples.going_on import (
    Floats,
    Whole,
)
from drivers.samples.intake import Intake
from drivers.samples.rotation import quaternion_from_euler
from drivers.samples.sensor_faults import REASONS
from drivers.samples.vehicle_clock import TimeField
from estimator.types import ZERO_VEC3, ImuSample, RateSample, Vec3, VelocitySample

Bytes = Any  # arrays of uint8


class _Stream(NamedTuple):
    """An IMU message's name and clock."""

    name: str
    clock: TimeField


class Batch(NamedTuple):
    """Frames as compiled code takes them: a row each, in the columns of ``usual_kinds``."""

    data: Bytes
    frames: Whole

    @classmethod
    def of(cls, arrived: Sequence[Arrived]) -> Self:
        """The batch of these frames, which are waiting."""
        said = [each.frame.data for each in arrived]
        n, ends = len(said), np.cumsum([len(each) for each in said])
        frames = np.zeros((n, BATCH_COLUMNS), np.int64)
        frames[1:, BEGIN], frames[:, STOP] = ends[:-1], ends
        frames[:, ARRIVAL] = [each.arrival_us for each in arrived]
        frames[:, FATE], frames[:, NUMBER] = WAITING, range(n)
        return cls(np.frombuffer(b"".join(said), np.uint8), frames)


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

    ``addresses`` of senders are by place, ``complaints`` about samples that were to be looked at by
    row, in order.
    """

    def __init__(
        self,
        addresses: Whole,
        intakes: list[Intake | None],
        streams: dict[int, _Stream],
        whole: Whole,
        numbers: Floats,
        arrivals_us: Whole,
        complaints: dict[int, list[Event]],
    ) -> None:
        self.addresses = addresses
        self.whole = whole
        self.numbers = numbers
        self.arrivals_us = arrivals_us
        self._intakes = intakes
        self._streams = streams
        self.complaints = complaints

    def __len__(self) -> int:
        return len(self.arrivals_us)

    def only(self, rows: Sequence[int]) -> "Readings":
        """Those rows alone."""
        complaints = self.complaints
        return Readings(
            self.addresses,
            self._intakes,
            self._streams,
            self.whole[rows],
            self.numbers[rows],
            self.arrivals_us[rows],
            {k: complaints[row] for k, row in enumerate(rows) if row in complaints},
        )

    def firsts(self, rows: Sequence[int]) -> tuple[list[int], list[int]]:
        """The first of those rows of each sender, and the others."""
        firsts: dict[int, int] = {}
        others = []
        for row, place in zip(rows, self.whole[rows, 1].tolist(), strict=True):
            if firsts.setdefault(place, row) != row:
                others.append(row)
        return list(firsts.values()), others

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
            events += self.complaints.get(k, [])
        return events

    def looks(self, rows: Iterable[int]) -> list[Event]:
        """Complaints about samples of those rows that were to be looked at."""
        return [event for k in rows for event in self.complaints.get(k, [])]

    def look(self) -> None:
        """Look at samples that are to be: at once, before anybody else does at what follows."""
        looks = (self.whole[:, 4] & TO_LOOK).nonzero()[0].tolist()
        self.complaints = {k: self._look(k) for k in looks}

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
