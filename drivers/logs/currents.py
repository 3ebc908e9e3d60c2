"""The current that a log's battery gave, for whoever looks for what it does to the compass.

Of telemetry SYS_STATUS, else the first battery's BATTERY_STATUS; of DataFlash BAT, or CURR before
2017. Live nobody asks, so these are no events.
"""

from collections.abc import Iterator
from math import isfinite
from typing import NamedTuple

from drivers.logs.dataflash import Dataflash
from drivers.logs.log_file import LogFile
from drivers.logs.tlog import Tlog

SYS_STATUS_ID, BATTERY_STATUS_ID = 1, 147
AMPERE = 1e-2  # of the messages' unit
UNKNOWN = -1
SOURCES = ("SYS_STATUS", "BATTERY_STATUS", "BAT", "CURR")  # the first that there is counts


class Reading(NamedTuple):
    """A current (A) at the log's own time."""

    source: str
    arrival_us: int
    ampere: float


def currents(log: LogFile, system_id: int) -> list[Reading]:
    """The readings of a vehicle's battery in order of time, of one source; none where it has none.

    Raises:
        InputError: the log cannot be read.
    """
    found: dict[str, list[Reading]] = {}
    for reading in _readings(log, system_id):
        if isfinite(reading.ampere):
            found.setdefault(reading.source, []).append(reading)
    chosen = next((found[source] for source in SOURCES if source in found), [])
    return sorted(chosen, key=lambda reading: reading.arrival_us)


def _readings(log: LogFile, system_id: int) -> Iterator[Reading]:
    if isinstance(log, Tlog):
        for arrival_us, frame, m in log.messages(frozenset({SYS_STATUS_ID, BATTERY_STATUS_ID})):
            is_first = frame.message_id == SYS_STATUS_ID or m.id == 0
            if frame.system_id == system_id and is_first and m.current_battery != UNKNOWN:
                source = SOURCES[frame.message_id == BATTERY_STATUS_ID]
                yield Reading(source, arrival_us, AMPERE * m.current_battery)
    elif isinstance(log, Dataflash):
        for name, arrival_us, row in log.rows(frozenset({"BAT", "CURR"})):
            if not row.get("Instance", row.get("Inst")):
                yield Reading(name, arrival_us, float(row["Curr"]))
