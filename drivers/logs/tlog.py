"""Telemetry logs (.tlog, and MAVProxy's .log): frames with the times they arrived.

Each record is a big-endian 64-bit Unix time in microseconds and one MAVLink
frame. Recorders put a link number into the two low bits, write garbage, and
sometimes a time from another age; none of that stops the reading.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any

from drivers.events import Event, Malformed, VehicleId
from drivers.logs.log_file import LATEST_US, LogFile, Window, windowed
from drivers.mavlink.constants import is_autopilot, mavlink
from drivers.mavlink.decoder import MavlinkDecoder
from drivers.mavlink.framing import Frame, FrameFormat, FrameReader, fields, frame_end
from drivers.mavlink.gate import FrameGate, Policy
from drivers.mavlink.messages import IMU_MESSAGES, message_to_ask_for
from estimator.errors import InputError

STAMP_SIZE = 8
ATTITUDES = ("ATTITUDE", "ATTITUDE_QUATERNION")
ONE_PEER = ""  # a log does not name who sent a frame

ORDINARY_STEP_US = 10 * 1_000_000  # a stamp further from the last counts if the next is near it
ORDINARY_BACK_US = 5 * 1_000_000
STAMP_STEP_US = 86_400 * 1_000_000  # two stamps further apart do not agree
STAMP_BACK_US = 3600 * 1_000_000
FIRST_RECORDS = 100  # two neighbours among these agree, or the last one is taken
RAW_FRAMES, RAW_SIZE = 3, 1000  # that many sound frames end to end, in bytes, are no accident


def believe(
    records: Iterable[tuple[int, Frame] | None], last_us: int
) -> Iterator[tuple[int, Frame | None]]:
    """The records with times to believe, from ``last_us`` on.

    A stamp away from the last one waits for the next record: if that is nearer to it than
    to the last, there was a pause, or a second session in the same file; if not, it was
    garbled, and the last good stamp stands in.
    """
    held: tuple[int, Frame] | None = None
    for record in records:
        if record is None:
            yield last_us, None
            continue
        stamp_us, frame = record
        if held is not None:
            if abs(stamp_us - held[0]) < abs(stamp_us - last_us):
                last_us = held[0]
            yield last_us, held[1]
        is_near = -ORDINARY_BACK_US <= stamp_us - last_us <= ORDINARY_STEP_US
        held = None if is_near else record
        if is_near:
            last_us = stamp_us
            yield last_us, frame
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
            frames = FrameReader().feed(data[:RAW_SIZE])[:RAW_FRAMES]
            begin = b"".join(each.data for each in frames)
            if len(frames) == RAW_FRAMES and data.startswith(begin):  # no times between them
                raise InputError(
                    f"{path}: MAVLink without time stamps (a raw capture), use the .tlog beside it"
                )
            window.end()  # a log has a sound frame within the first piece
            if not any(tlog_records(window)):
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

    def readings(self, names: frozenset[str]) -> Iterator[tuple[VehicleId, str, int, Any]]:
        """Messages as they were sent; see :meth:`LogFile.readings`."""
        kinds = mavlink().mavlink_map
        numbers = {number: kind.msgname for number, kind in kinds.items() if kind.msgname in names}
        for arrival_us, frame in self._frames(frozenset(numbers)):
            if frame is not None:
                sender = VehicleId(frame.system_id, frame.component_id)
                yield sender, numbers[frame.message_id], arrival_us, fields(frame)

    def advice(self, system_id: int | None = None) -> str | None:
        """See :meth:`LogFile.advice`."""
        attitude = autopilot = None
        imus = {imu.name for imu in IMU_MESSAGES.values()}
        for sender, name, _, m in self.readings(frozenset({"HEARTBEAT", *ATTITUDES, *imus})):
            if system_id not in (None, sender.system_id):
                continue
            if name == "HEARTBEAT":
                autopilot = m.autopilot if is_autopilot(m.autopilot, m.type) else autopilot
            elif name in ATTITUDES:
                attitude = name
            else:
                return None
        if attitude is None:
            return None
        message = message_to_ask_for(autopilot)
        return (
            f"{attitude} but no IMU message: ask for {message.name}: {message.setting}, "
            f"MAV_CMD_SET_MESSAGE_INTERVAL of message {message.number}, or fuzzbee run URL "
            "--request-rate 50 --record FILE"
        )

    def _frames(self, wanted: frozenset[int]) -> Iterator[tuple[int, Frame | None]]:
        with windowed(self.path, self.on_read) as window:
            records = tlog_records(window, wanted)
            first = [*islice(records, FIRST_RECORDS)]
            # the first stamp that the next one agrees with: a file may begin in mid-record
            stamps_us = [record[0] for record in first if record is not None]
            steps = pairwise(stamps_us)
            agreed = (a for a, b in steps if -STAMP_BACK_US <= b - a <= STAMP_STEP_US)
            first_us = next(agreed, stamps_us[-1] if stamps_us else 0)
            yield from believe(chain(first, records), first_us)


def tlog_records(
    window: Window, wanted: frozenset[int] | None = None
) -> Iterator[tuple[int, Frame] | None]:
    """The records of a telemetry log: (stamp in us, frame); None for each unreadable one.

    Only frames of the messages ``wanted`` (by number; None: all that are known) are given.
    An unreadable frame between two records costs itself alone; where no record follows it,
    the next sound frame of a known message is looked for.
    """
    frames = FrameFormat(gap=STAMP_SIZE)
    wanted = frozenset(mavlink().mavlink_map) if wanted is None else wanted

    def read(position: int) -> tuple[int, Sequence[tuple[int, Frame] | None]]:
        data, start = window.data, position + STAMP_SIZE
        if start >= len(data):
            return len(data), ()
        end = frame_end(data, start)
        if end is None or end > len(data):
            return position, ()
        frame = frames.frame(data, start, end)
        if frame is None:
            return (end, (None,)) if frames.is_followed(data, end) else (position, ())
        if frame.message_id not in wanted:
            return end, ()
        stamp_us = int.from_bytes(data[position:start], "big")
        return end, ((min(stamp_us, LATEST_US), frame),)

    def search(position: int) -> int | None:
        start = frames.next_start(window.data, position + STAMP_SIZE)
        return None if start is None else start - STAMP_SIZE

    return window.records(0, read, search)
