"""The readings of each compass in a log, for whoever calibrates another one than the first.

Of telemetry RAW_IMU and SCALED_IMU have the first, SCALED_IMU2 and SCALED_IMU3 the others; of
DataFlash MAG with its field I, or MAG, MAG2 and MAG3 before 2021. Live nobody asks, so these are no
events.
"""

from collections import defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drivers.logs.dataflash import MILLIGAUSS, Dataflash
from drivers.logs.log_file import LogFile
from drivers.logs.tlog import Tlog
from drivers.mavlink import constants as mav
from drivers.mavlink.messages import IMU_MESSAGES
from estimator.arrays import Floats, Times
from estimator.types import Vec3

NUMBERS = {
    mav.RAW_IMU_ID: 0,
    mav.SCALED_IMU_ID: 0,
    mav.SCALED_IMU2_ID: 1,
    mav.SCALED_IMU3_ID: 2,
}
MAGS = {"MAG": 0, "MAG2": 1, "MAG3": 2}


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
    for number, message, arrival_us, mag_gauss in _readings(log, system_id):
        if any(mag_gauss):
            found[number, message].append((arrival_us, mag_gauss))
    chosen: dict[int, CompassReadings] = {}
    for (number, message), rows in sorted(found.items(), key=lambda each: len(each[1])):
        arrivals_us, mags_gauss = (np.array(column) for column in zip(*rows, strict=True))
        chosen[number] = CompassReadings(message, arrivals_us, mags_gauss)
    return chosen


def _readings(log: LogFile, system_id: int) -> Iterator[tuple[int, str, int, Vec3]]:
    if isinstance(log, Tlog):
        for arrival_us, frame, m in log.messages(frozenset(NUMBERS)):
            if frame.system_id == system_id:
                kind = IMU_MESSAGES[frame.message_id]
                yield NUMBERS[frame.message_id], kind.name, arrival_us, kind.vectors(m)[2]
    elif isinstance(log, Dataflash):
        for name, arrival_us, row in log.rows(frozenset(MAGS)):
            x, y, z = (MILLIGAUSS * float(row[f"Mag{axis}"]) for axis in "XYZ")
            number = int(row.get("I", MAGS[name]))
            yield number, f"MAG[{number}]" if number else "MAG", arrival_us, (x, y, z)
