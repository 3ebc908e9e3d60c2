"""The latest of all vehicles, as views show it and metrics count it."""

import threading
from collections.abc import Iterable
from typing import NamedTuple

from drivers.resources import SLOTS
from service import records
from service.records import AttitudeRecord, State, StatusRecord

SILENT_AFTER_S = 3.0  # a status comes every second
LONGEST_MODE = 12  # letters


class Row(NamedTuple):
    """The latest of one vehicle, as it is worth at ``now_s``; ``heard_s`` is when (monotonic)."""

    name: str
    attitude: AttitudeRecord | None = None
    status: StatusRecord | None = None
    attitude_s: float = 0.0
    heard_s: float = 0.0
    before: StatusRecord | None = None  # the status before
    now_s: float = 0.0

    @property
    def state(self) -> State:
        """The state that was published last."""
        if self.attitude is not None and self.attitude_s >= self.heard_s:
            return State(self.attitude.state)
        return State(self.status.state) if self.status is not None else State.WAITING

    @property
    def is_silent(self) -> bool:
        """Whether the service publishes nothing about it any more."""
        return self.now_s - self.heard_s > SILENT_AFTER_S

    @property
    def valid_attitude(self) -> AttitudeRecord | None:
        """The attitude, or None where by its state it is no longer valid."""
        return self.attitude if self.state in records.HAS_ATTITUDE and not self.is_silent else None

    @property
    def state_text(self) -> str:
        """The state in a word, "silent" if the service publishes nothing about it any more."""
        return "silent" if self.is_silent else self.state.value

    @property
    def flight_words(self) -> list[str]:
        """The flight mode, and "armed" or "disarmed", as far as the vehicle sends them."""
        if self.status is None:
            return []
        armed = {None: "", True: "armed", False: "disarmed"}[self.status.armed]
        return [word for word in (self.status.mode[:LONGEST_MODE], armed) if word]

    @property
    def age_ms(self) -> float | None:
        """How old the IMU's sample is by now; None without an attitude."""
        if self.attitude is None:
            return None
        return self.attitude.age_ms + 1e3 * max(0.0, self.now_s - self.attitude_s)

    @property
    def age_text(self) -> str:
        """The age with its unit; nothing without one."""
        age_ms = self.age_ms
        if age_ms is None:
            return ""
        if age_ms < 1e3:
            return f"{age_ms:.0f} ms"
        return f"{age_ms / 1e3:.1f} s" if age_ms < 100e3 else f"{age_ms / 60e3:.0f} min"


class Latest:
    """The latest records of all vehicles; written by one thread, read by another."""

    def __init__(self) -> None:
        self._rows: dict[str, Row] = {}
        self._lock = threading.Lock()

    def take(self, outputs: Iterable[records.Output], now_s: float) -> list[str]:
        """Remember outputs of the service, of each vehicle its newest attitude; the messages."""
        texts: list[str] = []
        attitudes: dict[str, AttitudeRecord] = {}
        for output in outputs:
            match output:
                case records.Message(text=text):
                    texts.append(text)
                case records.Published(vehicle=vehicle, record=AttitudeRecord() as attitude):
                    attitudes[records.vehicle_name(vehicle)] = attitude
                case records.Published(vehicle=vehicle, record=status):
                    self.update(records.vehicle_name(vehicle), status, now_s)
                case records.Evicted(vehicle=vehicle):
                    attitudes.pop(records.vehicle_name(vehicle), None)
                    with self._lock:
                        self._rows.pop(records.vehicle_name(vehicle), None)
        for name, attitude in attitudes.items():
            self.update(name, attitude, now_s)
        return texts

    def update(self, name: str, record: AttitudeRecord | StatusRecord, now_s: float) -> None:
        """Remember a record; for a vehicle too many, who has been silent for longest goes."""
        with self._lock:
            if name not in self._rows and len(self._rows) >= SLOTS:
                del self._rows[min(self._rows.values(), key=lambda row: row.heard_s).name]
            old = self._rows.get(name) or Row(name)
            if isinstance(record, StatusRecord):
                row = old._replace(status=record, before=old.status)
            else:
                row = old._replace(attitude=record, attitude_s=now_s)
            self._rows[name] = row._replace(heard_s=max(old.heard_s, now_s))

    def rows(self, now_s: float = 0.0) -> list[Row]:
        """All rows by name, numbers in their order, as they are at ``now_s``."""
        with self._lock:
            rows = [row._replace(now_s=now_s) for row in self._rows.values()]
        return sorted(rows, key=lambda row: [int(part) for part in row.name.split("-")])
