"""What ``watch`` takes from the network: records that can be shown."""

import re
from collections import deque
from collections.abc import Callable, Iterator
from threading import Event
from typing import Any

import msgspec
import zenoh

from fuzzbee.notify import printable
from service.records import SCHEMA, AttitudeRecord, StatusRecord

VEHICLE = re.compile(r"[0-9]{1,3}(-[0-9]{1,3})?")
# 2 s of 50 vehicles at 100 Hz. When it is full the oldest is dropped: the newest is worth most.
MAX_PENDING = 10_000
# In bytes. Our largest record, a status with every reason for refusal, has less than 5000.
LONGEST_PAYLOAD = 16_384
SHOWN = 80  # so many characters of a key are printed

Record = AttitudeRecord | StatusRecord


class Reception:
    """Keeps samples between zenoh's thread and ours, and turns them into records."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        self.has_heard = False  # anything at all
        self.notify = notify
        self._reported: set[str] = set()  # why some were refused
        self._samples: deque[tuple[str, bytes]] = deque(maxlen=MAX_PENDING)
        self._have_come = Event()

    def put(self, sample: zenoh.Sample) -> None:
        """Take one; called by zenoh."""
        payload = sample.payload.to_bytes()[: LONGEST_PAYLOAD + 1]  # more is refused at any rate
        self._samples.append((str(sample.key_expr), payload))
        self._have_come.set()

    def records(self, timeout_s: float) -> Iterator[tuple[str, Record]]:
        """Vehicles' names and records that wait, after at most ``timeout_s`` for the first."""
        self._have_come.wait(timeout_s)
        self._have_come.clear()
        for _ in range(len(self._samples)):
            self.has_heard = True
            if (received := self.record(*self._samples.popleft())) is not None:
                yield received

    def record(self, key: str, payload: bytes) -> tuple[str, Record] | None:
        """The vehicle's name and its record, or None."""
        name, kind = key.rsplit("/", 2)[-2:]
        try:
            return name, _record(name, kind, payload)
        except ValueError as error:
            fault = str(error)
        if fault not in self._reported:
            self._reported.add(fault)
            where = repr(printable(key, SHOWN))
            self.notify(f"ignored: somebody publishes on {where}, but {fault}")
        return None


def _record(name: str, kind: str, payload: bytes) -> Record:
    """A record within the bounds of its type; what is wrong with it is one of few texts."""
    if not VEHICLE.fullmatch(name):
        raise ValueError("its key names no vehicle")
    if len(payload) > LONGEST_PAYLOAD:
        raise ValueError(f"it has more than {LONGEST_PAYLOAD} bytes")
    form: Any = AttitudeRecord if kind == "attitude" else StatusRecord
    try:
        record: Record = msgspec.json.decode(payload, type=form)
    except msgspec.ValidationError as error:
        raise ValueError(f"it is no {kind} record: {error}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise ValueError(f"it is no {kind} record") from None
    if isinstance(record, AttitudeRecord) and record.schema != SCHEMA:
        raise ValueError(f"its schema is not {SCHEMA}: of another version of fuzzbee")
    return record
