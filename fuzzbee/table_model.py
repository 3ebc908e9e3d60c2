"""The latest of all vehicles, as views show it."""

import threading
from collections.abc import Iterable
from typing import NamedTuple

from drivers.places import PLACES
from service.records import (
    HAS_ATTITUDE,
    AttitudeRecord,
    Departed,
    Message,
    Output,
    Published,
    State,
    StatusRecord,
    vehicle_name,
)

SILENT_AFTER_S = 3.0  # a status comes every second
LONGEST_MODE = 12  # letters


class Row(NamedTuple):
    """The latest of one vehicle; ``heard_s`` is when (monotonic)."""

    name: str
    attitude: AttitudeRecord | None = None
    status: StatusRecord | None = None
    attitude_s: float = 0.0
    heard_s: float = 0.0
    before: StatusRecord | None = None  # the status before

    @property
    def state(self) -> State:
        """The state that was published last."""
        if self.attitude is not None and self.attitude_s >= self.heard_s:
            return State(self.attitude.state)
        return State(self.status.state) if self.status is not None else State.WAITING


class TableModel:
    """The latest records of all vehicles; written by one thread, read by another.

    Where there is no room for one more, who has been silent for longest goes.
    """

    def __init__(self) -> None:
        self._rows: dict[str, Row] = {}
        self._lock = threading.Lock()

    def take(self, outputs: Iterable[Output], now_s: float) -> list[str]:
        """Remember outputs of the service, of each vehicle its newest attitude; the messages."""
        texts: list[str] = []
        attitudes: dict[str, AttitudeRecord] = {}
        for output in outputs:
            match output:
                case Message(text=text):
                    texts.append(text)
                case Published(vehicle=vehicle, record=AttitudeRecord() as attitude):
                    attitudes[vehicle_name(vehicle)] = attitude
                case Published(vehicle=vehicle, record=status):
                    self.update(vehicle_name(vehicle), status, now_s)
                case Departed(vehicle=vehicle):
                    attitudes.pop(vehicle_name(vehicle), None)
                    with self._lock:
                        self._rows.pop(vehicle_name(vehicle), None)
        for name, attitude in attitudes.items():
            self.update(name, attitude, now_s)
        return texts

    def update(self, name: str, record: AttitudeRecord | StatusRecord, now_s: float) -> None:
        """Remember a record."""
        with self._lock:
            if name not in self._rows and len(self._rows) >= PLACES:
                del self._rows[min(self._rows.values(), key=lambda row: row.heard_s).name]
            _, attitude, status, attitude_s, heard_s, before = self._rows.get(name) or Row(name)
            if isinstance(record, StatusRecord):
                status, before = record, status
            else:
                attitude, attitude_s = record, now_s
            # Row._make is the quickest way, and this runs thousands of times a second
            values = (name, attitude, status, attitude_s, max(heard_s, now_s), before)
            self._rows[name] = Row._make(values)

    def rows(self) -> list[Row]:
        """All rows by name, numbers in their order."""
        with self._lock:
            rows = list(self._rows.values())
        return sorted(rows, key=lambda row: [int(part) for part in row.name.split("-")])


def current_attitude(row: Row, now_s: float) -> AttitudeRecord | None:
    """The attitude, or None where the state says that it is no longer valid."""
    given = row.state in HAS_ATTITUDE and not is_silent(row, now_s)
    return row.attitude if given else None


def is_silent(row: Row, now_s: float) -> bool:
    """Whether the service says nothing about it any more."""
    return now_s - row.heard_s > SILENT_AFTER_S


def state_text(row: Row, now_s: float) -> str:
    """The state in a word, "silent" if the service says nothing about it any more."""
    return "silent" if is_silent(row, now_s) else row.state.value


def flight_words(row: Row) -> list[str]:
    """The flight mode, and "armed" or "disarmed", as far as the vehicle says them."""
    if row.status is None:
        return []
    armed = {None: "", True: "armed", False: "disarmed"}[row.status.armed]
    return [word for word in (row.status.mode[:LONGEST_MODE], armed) if word]


def age_text(row: Row, now_s: float) -> str:
    """How old the attitude is by now; nothing without one."""
    if row.attitude is None:
        return ""
    age_ms = row.attitude.age_ms + 1e3 * max(0.0, now_s - row.attitude_s)
    if age_ms < 1e3:
        return f"{age_ms:.0f} ms"
    if age_ms < 100e3:
        return f"{age_ms / 1e3:.1f} s"
    return f"{age_ms / 60e3:.0f} min"
