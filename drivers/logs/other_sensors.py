"""What a log has beside the IMU in use: further compasses, the battery's current, vibration.

Calibration and checks ask for it; live nobody does, so these are no events.
"""

from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from math import isfinite
from typing import NamedTuple

import numpy as np

from drivers.events import VehicleId
from drivers.logs.dataflash import MILLIGAUSS, Dataflash
from drivers.logs.dataflash_format import Row
from drivers.logs.log_file import LogFile
from drivers.logs.tlog import Tlog
from drivers.mavlink import constants as mav
from drivers.mavlink.messages import IMU_MESSAGES
from estimator.arrays import Floats, Times
from estimator.types import Vec3

# Numbers of compasses: of telemetry by message, of DataFlash before 2021 by name, then by field I
COMPASSES = {mav.RAW_IMU_ID: 0, mav.SCALED_IMU_ID: 0, mav.SCALED_IMU2_ID: 1, mav.SCALED_IMU3_ID: 2}
MAGS = {"MAG": 0, "MAG2": 1, "MAG3": 2}

SYS_STATUS_ID, BATTERY_STATUS_ID = 1, 147
AMPERE = 1e-2  # of the messages' unit
UNKNOWN = -1
# The first that there is counts; CURR is DataFlash's before 2017
CURRENT_SOURCES = ("SYS_STATUS", "BATTERY_STATUS", "BAT", "CURR")

VIBRATION_ID = 241
IMUS = range(3)


class CompassReadings(NamedTuple):
    """One compass's readings by the message that has most of them: arrivals (N,), gauss (N, 3)."""

    message: str
    arrivals_us: Times
    mag_gauss: Floats


def compasses(log: LogFile, system_id: int) -> dict[int, CompassReadings]:
    """The compasses of a vehicle by their numbers from 0; none where the log keeps but one.

    Raises:
        InputError: the log cannot be read.
    """
    found: defaultdict[tuple[int, str], list[tuple[int, Vec3]]] = defaultdict(list)
    for number, message, arrival_us, mag_gauss in _fields(log, system_id):
        if any(mag_gauss):
            found[number, message].append((arrival_us, mag_gauss))
    chosen: dict[int, CompassReadings] = {}
    for (number, message), rows in sorted(found.items(), key=lambda each: len(each[1])):
        arrivals_us, mags_gauss = (np.array(column) for column in zip(*rows, strict=True))
        chosen[number] = CompassReadings(message, arrivals_us, mags_gauss)
    return chosen


def _fields(log: LogFile, system_id: int) -> Iterator[tuple[int, str, int, Vec3]]:
    if isinstance(log, Tlog):
        for arrival_us, frame, m in log.messages(frozenset(COMPASSES)):
            if frame.system_id == system_id:
                kind = IMU_MESSAGES[frame.message_id]
                yield COMPASSES[frame.message_id], kind.name, arrival_us, kind.vectors(m)[2]
    elif isinstance(log, Dataflash):
        for name, arrival_us, row in log.rows(frozenset(MAGS)):
            x, y, z = (MILLIGAUSS * float(row[f"Mag{axis}"]) for axis in "XYZ")
            number = int(row.get("I", MAGS[name]))
            yield number, f"MAG[{number}]" if number else "MAG", arrival_us, (x, y, z)


class CurrentReading(NamedTuple):
    """A battery's current (A) at the log's own time."""

    source: str
    arrival_us: int
    ampere: float


def currents(log: LogFile, system_id: int) -> list[CurrentReading]:
    """The readings of a vehicle's battery in order of time, of one source; none where it has none.

    Raises:
        InputError: the log cannot be read.
    """
    found = [each for each in _currents(log, system_id) if isfinite(each.ampere)]
    source = min((each.source for each in found), key=CURRENT_SOURCES.index, default="")
    chosen = (each for each in found if each.source == source)
    return sorted(chosen, key=lambda reading: reading.arrival_us)


def _currents(log: LogFile, system_id: int) -> Iterator[CurrentReading]:
    if isinstance(log, Tlog):
        for arrival_us, frame, m in log.messages(frozenset({SYS_STATUS_ID, BATTERY_STATUS_ID})):
            is_first = frame.message_id == SYS_STATUS_ID or m.id == 0
            if frame.system_id == system_id and is_first and m.current_battery != UNKNOWN:
                source = CURRENT_SOURCES[frame.message_id == BATTERY_STATUS_ID]
                yield CurrentReading(source, arrival_us, AMPERE * m.current_battery)
    elif isinstance(log, Dataflash):
        for name, arrival_us, row in log.rows(frozenset({"BAT", "CURR"})):
            if not row.get("Instance", row.get("Inst")):
                yield CurrentReading(name, arrival_us, float(row["Curr"]))


class VibrationReading(NamedTuple):
    """Vibration (m/s^2) along each axis of an IMU, None where it is not known.

    ``clipped`` counts clipping since boot, by the number of the IMU from 0.
    """

    message: str
    arrival_us: int
    imu: int
    m_s2: Vec3 | None
    clipped: dict[int, int]


def vibrations(
    log: LogFile, vehicle: VehicleId, autopilot: int | None
) -> Iterator[VibrationReading]:
    """VIBRATION or VIBE of a vehicle in the order of the log; none where it has none.

    Of PX4's VIBRATION, which has other units than m/s^2, only the counts are read.

    Raises:
        InputError: the log cannot be read.
    """
    if isinstance(log, Tlog):
        for arrival_us, frame, m in log.messages(frozenset({VIBRATION_ID})):
            if (frame.system_id, frame.component_id) == vehicle:
                size = (m.vibration_x, m.vibration_y, m.vibration_z)
                is_other_unit = autopilot == mav.MAV_AUTOPILOT_PX4
                clipped = dict(enumerate((m.clipping_0, m.clipping_1, m.clipping_2)))
                m_s2 = None if is_other_unit else size
                yield VibrationReading("VIBRATION", arrival_us, 0, m_s2, clipped)
    elif isinstance(log, Dataflash):
        for _, arrival_us, row in log.rows(frozenset({"VIBE"})):
            with suppress(LookupError, TypeError, ValueError):  # garbage; another may be sound
                yield _of_row(arrival_us, row)


def _of_row(arrival_us: int, row: Row) -> VibrationReading:
    """VIBE: one IMU a message since 2020, before that the clipping of three."""
    imu = int(row.get("IMU", 0))
    names = {imu: "Clip"} if "Clip" in row else {n: f"Clip{n}" for n in IMUS}
    clipped = {n: int(row[name]) for n, name in names.items() if name in row}
    m_s2 = (float(row["VibeX"]), float(row["VibeY"]), float(row["VibeZ"]))
    return VibrationReading("VIBE", arrival_us, imu, m_s2, clipped)
