"""What the autopilot itself has logged of vibration and clipping: VIBE, and VIBRATION of telemetry.

VIBE has one IMU a message since 2020, and the clipping of three before. PX4's VIBRATION has other
units than m/s^2, so of that only the counts are read. Live nobody asks, so these are no events.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

from drivers.events import VehicleId
from drivers.logs.dataflash import Dataflash
from drivers.logs.dataflash_format import Row
from drivers.logs.log_file import LogFile
from drivers.logs.tlog import Tlog
from drivers.mavlink import constants as mav
from estimator.types import Vec3

VIBRATION_ID = 241
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


def vibrations(
    log: LogFile, vehicle: VehicleId, autopilot: int | None
) -> Iterator[VibrationReading]:
    """The readings of a vehicle in the order of the log; none where it has none.

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
    imu = int(row.get("IMU", 0))
    names = {imu: "Clip"} if "Clip" in row else {n: f"Clip{n}" for n in IMUS}
    clipped = {n: int(row[name]) for n, name in names.items() if name in row}
    m_s2 = (float(row["VibeX"]), float(row["VibeY"]), float(row["VibeZ"]))
    return VibrationReading("VIBE", arrival_us, imu, m_s2, clipped)
