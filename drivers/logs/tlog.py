"""Telemetry logs (.tlog, and MAVProxy's .log): frames with the times they arrived.

Each record is a big-endian 64-bit Unix time in microseconds and one MAVLink
frame. Recorders put a link number into the two low bits, write garbage, and
sometimes a time from another age; none of that stops the reading.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from drivers.events import Event, Malformed
from drivers.logs.log_file import LATEST_US, LogFile, Window, windowed
from drivers.mavlink.constants import mavlink
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import Data, FieldReader, Frame, FrameFormat, frame_end
from drivers.mavlink.gate import FrameGate, Policy
from estimator.errors import InputError

STAMP_SIZE = 8
ONE_PEER = ""  # a log does not name who sent a frame

ORDINARY_STEP_US = 10 * 1_000_000  # a stamp further from the last counts if the next is near it
ORDINARY_BACK_US = 5 * 1_000_000
STAMP_STEP_US = 86_400 * 1_000_000  # two stamps further apart do not agree
STAMP_BACK_US = 3600 * 1_000_000
SNIFF_SIZE = 1 << 20  # a log has a sound frame within its first MiB
FIRST_RECORDS = 100  # two neighbours among these agree, or the last one is taken
RAW_FRAMES = 3  # that many sound frames end to end are no accident


def believe(
    records: Iterable[tuple[int, Frame | None]], last_us: int
) -> Iterator[tuple[int, Frame | None]]:
    """The records with times to believe, from ``last_us`` on.

    A stamp away from the last one waits for the next record: if that is nearer to it than
    to the last, there was a pause, or a second session in the same file; if not, it was
    garbled, and the last good stamp stands in. An unreadable record's own stamp is as
    doubtful as its frame.
    """
    held: tuple[int, Frame] | None = None
    for stamp_us, frame in records:
        if frame is None:
            yield last_us, None
            continue
        if held is not None:
            held_us, held_frame = held
            held = None
            if abs(stamp_us - held_us) < abs(stamp_us - last_us):
                last_us = held_us
            yield last_us, held_frame
        if -ORDINARY_BACK_US <= stamp_us - last_us <= ORDINARY_STEP_US:
            last_us = stamp_us
            yield last_us, frame
        else:
            held = stamp_us, frame
    if held is not None:
        yield last_us, held[1]


class Tlog(LogFile):
    """A telemetry log as events; each iteration reads the file from its start.

    Raises:
        InputError: from the constructor, if the file holds no MAVLink frame
            with a time before it.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with windowed(path) as window:
            data = window.data
            if _is_raw_capture(data):
                raise InputError(
                    f"{path}: MAVLink without time stamps (a raw capture), use the .tlog beside it"
                )
            if next(TlogRecords(Window(data[:SNIFF_SIZE]), None).readable(), None) is None:
                raise InputError(f"{path}: no MAVLink frame in it, not a telemetry log")

    def __iter__(self) -> Iterator[Event]:
        gate, decoder = FrameGate(Policy()), MavlinkDecoder(texts=True)
        decoder.imu_in_use = self.imu_in_use
        for arrival_us, frame in self._frames(decoder.wanted):
            if frame is None:
                yield Malformed(arrival_us, 1)
            elif gate.lets_in(frame, ONE_PEER, arrival_us):
                yield from decoder.events(frame, arrival_us)
            else:
                yield from gate.take_refused(arrival_us)
        yield from decoder.end()

    def messages(self, wanted: frozenset[int]) -> Iterator[tuple[int, Frame, Any]]:
        """Messages of those numbers: arrival, frame, and what has its fields as attributes."""
        reader = FieldReader()
        for arrival_us, frame in self._frames(wanted):
            fields = None if frame is None else reader.fields(frame)
            if frame is not None and fields is not None:
                yield arrival_us, frame, fields

    def _frames(self, wanted: frozenset[int]) -> Iterator[tuple[int, Frame | None]]:
        with windowed(self.path, self.on_read) as window:
            first_us = _first_stamp_us(window)
        with windowed(self.path, self.on_read) as window:
            yield from believe(TlogRecords(window, wanted), first_us)


class TlogRecords:
    """The records of a telemetry log: (stamp in us, frame, or None where it is unreadable).

    Only frames of the messages ``wanted`` (by number; None: all that are known) are given.
    An unreadable frame between two records costs itself alone; where no record follows it,
    the next sound frame of a known message is looked for.
    """

    def __init__(self, window: Window, wanted: frozenset[int] | None) -> None:
        self._window = window
        self._data = window.data
        self._format = FrameFormat(gap=STAMP_SIZE)
        self._wanted = frozenset(mavlink().mavlink_map) if wanted is None else wanted

    def __iter__(self) -> Iterator[tuple[int, Frame | None]]:
        position, stamp_us = 0, 0
        while True:
            if self._window.is_near_end(position):
                position = self._window.move(position)
                self._data = self._window.data
            if position + STAMP_SIZE >= len(self._data):
                return
            end, frame = frame_end(self._data, position + STAMP_SIZE), None
            if end is not None and end > len(self._data):
                end = None
            if end is not None:
                frame = self._format.frame(self._data, position + STAMP_SIZE, end)
            if end is None or frame is None:
                yield stamp_us, None
                position = self._behind_unreadable(position, end)
                continue
            if frame.message_id in self._wanted:
                stamp = self._data[position : position + STAMP_SIZE]
                stamp_us = min(int.from_bytes(stamp, "big"), LATEST_US)
                yield stamp_us, frame
            position = end

    def readable(self) -> Iterator[tuple[int, Frame]]:
        """The records without the unreadable ones."""
        return ((stamp_us, frame) for stamp_us, frame in self if frame is not None)

    def _behind_unreadable(self, position: int, end: int | None) -> int:
        """The next record behind an unreadable one that claims to end at ``end``."""
        if end is not None and self._format.is_followed(self._data, end):
            return end
        found = self._window.find(position + 1, self._next_record)
        self._data = self._window.data
        return found

    def _next_record(self, position: int) -> int | None:
        """Where the record of the next sound frame begins, from there on."""
        start = self._format.next_start(self._window.data, position + STAMP_SIZE)
        return None if start is None else start - STAMP_SIZE


def _first_stamp_us(window: Window) -> int:
    """The first stamp that the next one agrees with: a file may begin in mid-record."""
    previous_us = 0
    for number, (stamp_us, _) in enumerate(TlogRecords(window, None).readable()):
        if number and -STAMP_BACK_US <= stamp_us - previous_us <= STAMP_STEP_US:
            return previous_us
        if number >= FIRST_RECORDS:
            break
        previous_us = stamp_us
    return previous_us


def _is_raw_capture(data: Data) -> bool:
    """Whether the data begins with frames one behind the other, without times between."""
    frames, position = FrameFormat(), 0
    for _ in range(RAW_FRAMES):
        end = frame_end(data, position)
        if end is None or end > len(data) or frames.frame(data, position, end) is None:
            return False
        position = end
    return True
