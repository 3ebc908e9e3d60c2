"""ArduPilot's on-board logs (DataFlash .bin).

The messages read, with the names of both eras: IMU, IMU2, IMU3 (or the field I), MAG, ATT, XKQ/NKQ,
XKF1/NKF1/EKF1, XKF4/NKF4/EKF4, GPS, PARM, MSG, ARM, EV, MODE, and SIM as truth. Accelerometer and
gyroscope are SI in the log, the field is in mGauss, angles are in degrees. Times count from boot,
in us or, until 2015, in ms.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

from drivers.events import Event, Heartbeat, ModeChange, Parameter, VehicleId
from drivers.logs.dataflash_format import Row, messages
from drivers.logs.log_file import LogFile, windowed
from drivers.logs.logged_vehicle import UNREADABLE, LoggedVehicle
from drivers.mavlink import constants as mav
from drivers.mavlink.ardupilot import SYSTEM_ID
from drivers.samples.navigation import Fix
from drivers.samples.vehicle_clock import TimeField

MILLIGAUSS = 1e-3
VEHICLE_TYPES = {  # the first word of MSG at start, and its MAV_TYPE
    "ArduCopter": mav.MAV_TYPE_QUADROTOR,
    "ArduPlane": mav.MAV_TYPE_FIXED_WING,
    "ArduRover": mav.MAV_TYPE_GROUND_ROVER,
    "Rover": mav.MAV_TYPE_GROUND_ROVER,
    "ArduSub": mav.MAV_TYPE_SUBMARINE,
    "AntennaTracker": mav.MAV_TYPE_ANTENNA_TRACKER,
    "Blimp": mav.MAV_TYPE_AIRSHIP,
}
# Of EV, which older logs have alone
ARMED_EVENT, DISARMED_EVENT = 10, 11
LONGEST_UPTIME_US = 10 * 366 * 86_400 * 1_000_000  # a longer time since boot is garbage
GPS_EPOCH_S = 315_964_800  # 1980-01-06 in Unix time
WEEK_S = 604_800
LAST_WEEK = 0xFFFF  # the field's end
LEAP_SECONDS = 18  # GPS time minus UTC since 2017


class Dataflash(LogFile):
    """A DataFlash log as events; each iteration reads the file from its start.

    The arrival times are the log's own times, on Unix time where the log has
    a GPS time and counted from boot otherwise.
    """

    def __iter__(self) -> Iterator[Event]:
        vehicle = LoggedVehicle(*self._identity())
        with windowed(self.path, self.on_read) as window:
            yield from vehicle.events(messages(window, NAMES), _events)

    def readings(self, names: frozenset[str]) -> Iterator[tuple[VehicleId, str, int, Any]]:
        """Messages that have a time; see :meth:`LogFile.readings`."""
        vehicle, unix_us = self._identity()
        with windowed(self.path) as window:
            for name, row in filter(None, messages(window, names)):
                with suppress(*UNREADABLE):
                    arrival_us = unix_us + _time_us(name, row)[0]
                    yield vehicle, name, arrival_us, SimpleNamespace(**row)

    def advice(self, system_id: int | None = None) -> str | None:
        """See :meth:`LogFile.advice`."""
        found = {
            name
            for vehicle, name, _, _ in self.readings(frozenset(("ATT", "IMU")))
            if system_id in (None, vehicle.system_id)
        }
        if found != {"ATT"}:
            return None
        return "attitudes but no IMU message: set the IMU bit of LOG_BITMASK and log again"

    def _identity(self) -> tuple[VehicleId, int]:
        """Its system, 1 unless a parameter has another; Unix time minus time since boot, in us.

        Both are near the log's beginning, if it has them.
        """
        system_id = unix_us = None
        with windowed(self.path, self.on_read) as window:
            for name, row in filter(None, messages(window, ("PARM", "GPS"))):
                # garbage is passed over; another one may be sound
                with suppress(*UNREADABLE):
                    if unix_us is None and name == "GPS":
                        unix_us = _unix_us(row)
                    elif system_id is None and name == "PARM" and row["Name"] in SYSTEM_ID:
                        system_id = int(row["Value"]) if 1 <= row["Value"] <= 255 else None
                if system_id is not None and unix_us is not None:
                    break
        return VehicleId(system_id or 1, 1), unix_us or 0


def _events(vehicle: LoggedVehicle, message: tuple[str, Row]) -> list[Event]:
    """The events of a message, if it is of the first of several sensors or filters, or of an IMU.

    Old logs have but one.
    """
    name, row = message
    if name not in UNTIMED:
        vehicle.at(*_time_us(name, row))
    if name != "IMU" and any(int(row.get(each, 0)) for each in ("I", "C")):
        return []
    about = vehicle.id, vehicle.arrival_us
    match name:
        case "IMU" | "IMU2" | "IMU3":
            instance = int(row.get("I", 0))  # newer logs number them from 0 in a field
            stream = f"IMU{instance + 1}" if instance else name
            gyr = (row["GyrX"], row["GyrY"], row["GyrZ"])
            return vehicle.imu(stream, gyr, (row["AccX"], row["AccY"], row["AccZ"]))
        case "MAG":
            x, y, z = (MILLIGAUSS * row[axis] for axis in ("MagX", "MagY", "MagZ"))
            return vehicle.put_mag((x, y, z))
        case "XKF1" | "NKF1" | "EKF1":
            return vehicle.fix(name, Fix((row["VN"], row["VE"], row["VD"])))
        case "XKF4" | "NKF4" | "EKF4":
            if "SS" not in row:  # the first years' filters did not report it
                return []
            return vehicle.filter_status(row["SS"], row["SV"], row.get("SM", 0.0))
        case "GPS":
            return _gps(vehicle, row)
        case "PARM":
            return [Parameter(*about, row["Name"], float(row["Value"]))]
        case "MSG":
            first = str(row["Message"]).partition(" ")[0]
            types = [VEHICLE_TYPES[first]] if first in VEHICLE_TYPES else []
            return [Heartbeat(*about, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, each) for each in types]
        case "ARM":
            return [ModeChange(*about, bool(row["ArmState"]))]
        case "EV" if row["Id"] not in (ARMED_EVENT, DISARMED_EVENT):
            return []
        case "EV":
            vehicle.at(*_time_us(name, row))
            return [ModeChange(vehicle.id, vehicle.arrival_us, row["Id"] == ARMED_EVENT)]
        case "MODE":
            mode = row["ModeNum"] if "ModeNum" in row else row["Mode"]
            return [ModeChange(*about, custom_mode=int(mode))]
        case _:
            return _attitude(vehicle, name, row)


def _attitude(vehicle: LoggedVehicle, name: str, row: Row) -> list[Event]:
    if "Q1" in row:
        numbers = [row["Q1"], row["Q2"], row["Q3"], row["Q4"]]
    else:
        numbers = [math.radians(row[angle]) for angle in ("Roll", "Pitch", "Yaw")]
    return vehicle.attitude(name, "sim" if name == "SIM" else "autopilot", numbers)


def _gps(vehicle: LoggedVehicle, row: Row) -> list[Event]:
    if row["Status"] < mav.GPS_FIX_TYPE_3D_FIX:
        return []
    speed_m_s, course_rad = row["Spd"], math.radians(row["GCrs"])
    north, east = speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad)
    position = (row["Lat"], row["Lng"], row["Alt"])
    fix = Fix((north, east, row.get("VZ", 0.0)), has_vertical="VZ" in row, position=position)
    return vehicle.fix("GPS", fix)


UNTIMED = frozenset(("PARM", "MSG", "EV"))  # their times are looked at where they matter
NAMES = {"IMU", "IMU2", "IMU3", "MAG", "GPS", "ARM", "MODE", "ATT", "XKQ", "NKQ", "NKQ1", "SIM"}
NAMES |= {"XKF1", "NKF1", "EKF1", "XKF4", "NKF4", "EKF4"} | UNTIMED


def _unix_us(row: Row) -> int | None:
    """Unix time minus time since boot; None if the receiver did not know the week yet."""
    week, week_ms = (row["GWk"], row["GMS"]) if "GWk" in row else (row["Week"], row["TimeMS"])
    if week <= 0:
        return None
    if week > LAST_WEEK:
        raise ValueError(week)
    unix_s = GPS_EPOCH_S + week * WEEK_S + week_ms * 1e-3 - LEAP_SECONDS
    return int(unix_s * 1e6) - _time_us("GPS", row)[0]


def _time_us(name: str, row: Row) -> tuple[int, TimeField]:
    """The message's time since boot, and on which clock.

    Raises:
        LookupError, TypeError, ValueError, OverflowError: it has none that can be.
    """
    if "TimeUS" in row:
        clock, raw_us = TimeField.TIME_USEC, int(row["TimeUS"])
    else:  # a GPS message's TimeMS is the GPS week's
        clock, raw_us = TimeField.BOOT_MS, int(row["T" if name == "GPS" else "TimeMS"]) * 1000
    if not 0 <= raw_us <= LONGEST_UPTIME_US:
        raise ValueError(raw_us)
    return raw_us, clock
