"""What a log has beside the IMU in use: further compasses, the battery's current, vibration.

Calibration and checks ask for it; live nobody does, so these are no events.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator
from contextlib import suppress
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from drivers.events import VehicleId
from drivers.logs.log_file import LogFile
from drivers.mavlink import constants as mav
from drivers.mavlink.messages import CENTI, IMU_MESSAGES, MILLI
from estimator.types import Floats, Times, Vec3

VECTORS = {imu.name: imu.vectors for imu in IMU_MESSAGES.values()}
# Numbers of compasses: of telemetry by message, of DataFlash before 2021 by name, then by field I
COMPASSES = {"RAW_IMU": 0, "SCALED_IMU": 0, "SCALED_IMU2": 1, "SCALED_IMU3": 2}
COMPASSES |= {"MAG": 0, "MAG2": 1, "MAG3": 2}

UNKNOWN = -1
# The first that there is counts; CURR is DataFlash's before 2017
CURRENT_SOURCES = ("SYS_STATUS", "BATTERY_STATUS", "BAT", "CURR")

IMUS = range(3)


class VibrationReading(NamedTuple):
    """Vibration (m/s^2) along each axis of an IMU, None where it is not known.

    ``clipped`` counts clipping since boot, by the number of the IMU from 0.
    """

    message: str
    arrival_us: int
    imu: int
    m_s2: Vec3 | None
    clipped: dict[int, int]


def compasses(log: LogFile, system_id: int) -> dict[int, tuple[str, Times, Floats]]:
    """The compasses of a vehicle by their numbers from 0; none where the log keeps but one.

    Of each the message that has most readings, their arrivals (N,) and fields (gauss, (N, 3)).

    Raises:
        InputError: the log cannot be read.
    """
    found: defaultdict[tuple[int, str], list[tuple[int, Vec3]]] = defaultdict(list)
    for name, arrival_us, m in _of(log, system_id, COMPASSES):
        number, message = COMPASSES[name], name
        if name in VECTORS:
            mag_gauss = VECTORS[name](m)[2]
        else:
            number = int(getattr(m, "I", number))
            message = f"MAG[{number}]" if number else "MAG"
            mag_gauss = (MILLI * m.MagX, MILLI * m.MagY, MILLI * m.MagZ)
        if any(mag_gauss):
            found[number, message].append((arrival_us, mag_gauss))
    chosen: dict[int, tuple[str, Times, Floats]] = {}
    for (number, message), rows in sorted(found.items(), key=lambda each: len(each[1])):
        arrivals_us, mags_gauss = (np.array(column) for column in zip(*rows, strict=True))
        chosen[number] = message, arrivals_us, mags_gauss
    return chosen


def currents(log: LogFile, system_id: int) -> list[tuple[int, float]]:
    """The current (A) of a vehicle's battery at the log's own times, in their order, of one source.

    Raises:
        InputError: the log cannot be read.
    """
    found: defaultdict[str, list[tuple[int, float]]] = defaultdict(list)
    for name, arrival_us, m in _of(log, system_id, CURRENT_SOURCES):
        is_telemetry = hasattr(m, "current_battery")
        ampere = CENTI * m.current_battery if is_telemetry else float(m.Curr)
        is_known = not is_telemetry or m.current_battery != UNKNOWN
        numbers = (getattr(m, each, 0) for each in ("id", "Instance", "Inst"))
        if is_known and isfinite(ampere) and not any(numbers):
            found[name].append((arrival_us, ampere))
    source = min(found, key=CURRENT_SOURCES.index, default="")
    return sorted(found[source], key=lambda reading: reading[0])


def vibrations(
    log: LogFile, vehicle: VehicleId, autopilot: int | None
) -> Iterator[VibrationReading]:
    """VIBRATION or VIBE of a vehicle in the order of the log; none where it has none.

    Of PX4's VIBRATION, which has other units than m/s^2, only the counts are read.

    Raises:
        InputError: the log cannot be read.
    """
    for name, arrival_us, m in _of(log, vehicle, ("VIBRATION", "VIBE")):
        if name == "VIBRATION":
            size = (m.vibration_x, m.vibration_y, m.vibration_z)
            m_s2 = None if autopilot == mav.MAV_AUTOPILOT_PX4 else size
            clipped = {n: getattr(m, f"clipping_{n}") for n in IMUS}
            yield VibrationReading(name, arrival_us, 0, m_s2, clipped)
            continue
        with suppress(AttributeError, TypeError, ValueError):  # garbage; another may be sound
            imu = int(getattr(m, "IMU", 0))  # one a message since 2020, before that three
            names = {imu: "Clip"} if hasattr(m, "Clip") else {n: f"Clip{n}" for n in IMUS}
            clipped = {n: int(getattr(m, each)) for n, each in names.items() if hasattr(m, each)}
            m_s2 = (float(m.VibeX), float(m.VibeY), float(m.VibeZ))
            yield VibrationReading(name, arrival_us, imu, m_s2, clipped)


def _of(
    log: LogFile, sender: int | VehicleId, names: Collection[str]
) -> Iterator[tuple[str, int, Any]]:
    """The messages of a system or of a vehicle: name, arrival, and the fields as attributes."""
    for vehicle, name, arrival_us, m in log.readings(frozenset(names)):
        if sender in (vehicle, vehicle.system_id):
            yield name, arrival_us, m
