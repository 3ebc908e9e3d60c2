"""What ``watch`` takes from the network: records that can be shown."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from fuzzbee.notify import printable
from service.records import SCHEMA, AttitudeRecord, State, StatusRecord

VEHICLE = re.compile(r"[0-9]{1,3}(-[0-9]{1,3})?")
# In bytes. Our largest record, a status with every reason for refusal, has less than 5000.
LONGEST_PAYLOAD = 16_384
IMU_MESSAGE = re.compile(r"[A-Za-z0-9_/:.-]{1,64}")  # or a topic of a bag
MOST_IMUS = 33  # of a vehicle, by whatever messages
MODE = re.compile(r"[A-Za-z0-9_ .:/-]{0,32}")
STATES = frozenset(state.value for state in State)
HEADING_REFERENCES = ("true", "magnetic", "none")
MOST_ANGLE_DEG = 360.0
MOST_GAIN = 1e7
MOST_RATE_HZ = 1e6
MOST = 1e12  # limit of every other number
SHOWN = 80  # so many characters of a key are printed

Record = AttitudeRecord | StatusRecord


class Reception:
    """Turns keys and payloads into records; says once for each reason why some are refused."""

    def __init__(self, notify: Callable[[str], None]) -> None:
        self._say = notify
        self._told: set[str] = set()

    def record(self, key: str, payload: bytes) -> tuple[str, Record] | None:
        """The vehicle's name and its record, or None."""
        name, kind = key.rsplit("/", 2)[-2:]
        try:
            record = self._record(name, kind, payload)
        except ValueError as fault:
            self._tell(str(fault), key)
            return None
        return name, record

    def _record(self, name: str, kind: str, payload: bytes) -> Record:
        if not VEHICLE.fullmatch(name):
            raise ValueError("its key names no vehicle")
        if len(payload) > LONGEST_PAYLOAD:
            raise ValueError(f"it has more than {LONGEST_PAYLOAD} bytes")
        form: Any = AttitudeRecord if kind == "attitude" else StatusRecord
        try:
            record: Record = msgspec.json.decode(payload, type=form)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise ValueError(f"it is no {kind} record") from None
        fault = _fault(record)
        if fault is not None:
            raise ValueError(fault)
        return record

    def _tell(self, reason: str, key: str) -> None:
        if reason not in self._told:
            self._told.add(reason)
            self._say(f"ignored: somebody publishes on {printable(key, SHOWN)!r}, but {reason}")


def _fault(record: Record) -> str | None:
    """Why a record cannot be shown."""
    if record.state not in STATES:
        return "its state is unknown"
    if any(not -MOST <= number <= MOST for number in _numbers(msgspec.structs.astuple(record))):
        return "its numbers are no measurements"
    if isinstance(record, StatusRecord):
        messages = [*record.other_imus, *filter(None, [record.imu_message])]
        are_some = record.imu_message != "" and len(messages) <= MOST_IMUS
        if not are_some or not all(map(IMU_MESSAGE.fullmatch, messages)):
            return "its imu_message is no IMU's message"
        if not MODE.fullmatch(record.mode):
            return "its mode is no flight mode"
        if not -MOST_ANGLE_DEG <= (record.compass_off_deg or 0.0) <= MOST_ANGLE_DEG:
            return "its compass_off_deg is no angle"
        return None if 0.0 <= record.imu_rate_hz <= MOST_RATE_HZ else "its rate is no rate"
    if record.schema != SCHEMA:
        return f"its schema is not {SCHEMA}: of another version of fuzzbee"
    if record.heading_reference not in HEADING_REFERENCES:
        return "its heading_reference is unknown"
    is_sound = (
        all(abs(angle) <= MOST_ANGLE_DEG for angle in record.euler_deg)
        and 0.0 <= record.error <= 1.0
        and 0.0 <= record.gain <= MOST_GAIN
        and record.age_ms >= 0.0
    )
    return None if is_sound else "its numbers are no attitude"


def _numbers(values: Any) -> Iterator[float]:
    """The numbers of a record but its counts and times, which are whole."""
    for value in values:
        if isinstance(value, float):
            yield value
        elif isinstance(value, dict):
            yield from _numbers(tuple(value.values()))
        elif isinstance(value, tuple):
            yield from _numbers(value)
        elif isinstance(value, msgspec.Struct):
            yield from _numbers(msgspec.structs.astuple(value))
