"""ArduPilot's on-board logs (DataFlash .bin).

The messages read, with the names of both eras: IMU, IMU2, IMU3 (or the field
I), MAG, ATT, XKQ/NKQ, XKF1/NKF1/EKF1, XKF4/NKF4/EKF4, GPS, PARM, MSG, ARM, EV,
MODE, and SIM as truth.
Accelerometer and gyroscope are SI in the log, the field is in mGauss, angles
are in degrees. Times count from boot, in us or, until 2015, in ms.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress

from drivers.events import Event, Heartbeat, Malformed, ModeChange, Parameter, VehicleId
from drivers.logs.dataflash_format import Row, messages
from drivers.logs.log_file import LogFile, Window, windowed
from drivers.logs.logged_vehicle import LoggedVehicle
from drivers.mavlink import constants as mav
from drivers.mavlink.ardupilot import SYSTEM_ID
from drivers.samples.attitudes import quaternion_from_euler, unit_or_none
from drivers.samples.navigation import Fix, filter_status
from drivers.samples.vehicle_clock import TimeField
from estimator.types import Quaternion

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
        with windowed(self.path, self.on_read) as window:
            system_id, unix_us = _identity(window)
        with windowed(self.path, self.on_read) as window:
            decoder = _Decoder(system_id, unix_us)
            for message in messages(window, decoder.message_names):
                yield from decoder.decode(message)

    def rows(self, names: frozenset[str]) -> Iterator[tuple[str, int, Row]]:
        """Messages of those names that have a time: name, arrival and columns."""
        with windowed(self.path) as window:
            unix_us = _identity(window)[1]
        with windowed(self.path) as window:
            for name, row in filter(None, messages(window, names)):
                with suppress(LookupError, TypeError, ValueError, OverflowError):
                    yield name, unix_us + _time_us(name, row)[1], row


class _Decoder:
    """DataFlash messages in, events out."""

    def __init__(self, system_id: int, unix_us: int) -> None:
        self._vehicle = LoggedVehicle(VehicleId(system_id, 1), unix_us)
        self._arrival_us = unix_us
        self._handlers: dict[str, Callable[[str, Row], list[Event]]] = {
            "IMU": self._imu,
            "IMU2": self._imu,
            "IMU3": self._imu,
            "MAG": self._mag,
            "ATT": self._attitude,
            "XKQ": self._attitude_quaternion,
            "NKQ": self._attitude_quaternion,
            "NKQ1": self._attitude_quaternion,
            "XKF1": self._filter_velocity,
            "NKF1": self._filter_velocity,
            "EKF1": self._filter_velocity,
            "XKF4": self._filter_status,
            "NKF4": self._filter_status,
            "EKF4": self._filter_status,
            "GPS": self._gps,
            "SIM": self._truth,
            "PARM": self._parameter,
            "MSG": self._text,
            "ARM": self._arm,
            "EV": self._event,
            "MODE": self._mode,
        }

    @property
    def message_names(self) -> frozenset[str]:
        return frozenset(self._handlers)

    def decode(self, message: tuple[str, Row] | None) -> list[Event]:
        """The events of a message; None stands for one that could not be read."""
        if message is None:
            return [Malformed(self._arrival_us, 1)]
        name, row = message
        try:
            return self._handlers[name](name, row)
        except (LookupError, TypeError, ValueError, OverflowError):
            # a message of that name with other columns, or a column with garbage in it
            return [Malformed(self._arrival_us, 1)]

    def _time(self, name: str, row: Row) -> tuple[TimeField, int]:
        field, raw_us = _time_us(name, row)
        self._arrival_us = self._vehicle.arrival_us(raw_us)
        return field, raw_us

    def _imu(self, name: str, row: Row) -> list[Event]:
        gyr = (float(row["GyrX"]), float(row["GyrY"]), float(row["GyrZ"]))
        acc = (float(row["AccX"]), float(row["AccY"]), float(row["AccZ"]))
        instance = _instance(row, "I")  # newer logs number them from 0 in a field
        stream = f"IMU{instance + 1}" if instance else name
        return self._vehicle.imu(stream, *self._time(name, row), gyr, acc)

    def _mag(self, name: str, row: Row) -> list[Event]:
        if _instance(row, "I") == 0:
            mag = (row["MagX"] * MILLIGAUSS, row["MagY"] * MILLIGAUSS, row["MagZ"] * MILLIGAUSS)
            self._vehicle.put_mag(mag, _time_us(name, row)[1])
        return []

    def _attitude(self, name: str, row: Row) -> list[Event]:
        q = _from_degrees(row)
        return self._vehicle.attitude(name, *self._time(name, row), "autopilot", q)

    def _attitude_quaternion(self, name: str, row: Row) -> list[Event]:
        if _instance(row, "C") != 0:
            return []
        q = _from_quaternion(row)
        return self._vehicle.attitude(name, *self._time(name, row), "autopilot", q)

    def _truth(self, name: str, row: Row) -> list[Event]:
        q = _from_quaternion(row) if "Q1" in row else _from_degrees(row)
        return self._vehicle.attitude(name, *self._time(name, row), "sim", q)

    def _filter_velocity(self, name: str, row: Row) -> list[Event]:
        if _instance(row, "C") != 0:
            return []
        velocity = (float(row["VN"]), float(row["VE"]), float(row["VD"]))
        return self._vehicle.fix(name, *self._time(name, row), Fix(velocity))

    def _filter_status(self, name: str, row: Row) -> list[Event]:
        if _instance(row, "C") == 0 and "SS" in row:  # the first years' filters did not say
            status = filter_status(int(row["SS"]), float(row["SV"]), float(row.get("SM", 0.0)))
            return self._vehicle.filter_says(status, _time_us(name, row)[1])
        return []

    def _gps(self, name: str, row: Row) -> list[Event]:
        if row["Status"] < mav.GPS_FIX_TYPE_3D_FIX or _instance(row, "I") != 0:
            return []
        speed_m_s, course_rad = row["Spd"], math.radians(row["GCrs"])
        velocity = (
            speed_m_s * math.cos(course_rad),
            speed_m_s * math.sin(course_rad),
            float(row.get("VZ", 0.0)),
        )
        position = (float(row["Lat"]), float(row["Lng"]), float(row["Alt"]))
        fix = Fix(velocity, has_vertical="VZ" in row, position=position)
        return self._vehicle.fix(name, *self._time(name, row), fix)

    def _parameter(self, _name: str, row: Row) -> list[Event]:
        return [Parameter(self._vehicle.id, self._arrival_us, row["Name"], float(row["Value"]))]

    def _arm(self, name: str, row: Row) -> list[Event]:
        self._time(name, row)
        return [ModeChange(self._vehicle.id, self._arrival_us, is_armed=bool(row["ArmState"]))]

    def _event(self, name: str, row: Row) -> list[Event]:
        if row["Id"] not in (ARMED_EVENT, DISARMED_EVENT):
            return []
        self._time(name, row)
        is_armed = row["Id"] == ARMED_EVENT
        return [ModeChange(self._vehicle.id, self._arrival_us, is_armed=is_armed)]

    def _mode(self, name: str, row: Row) -> list[Event]:
        self._time(name, row)
        number = int(row["ModeNum"] if "ModeNum" in row else row["Mode"])
        return [ModeChange(self._vehicle.id, self._arrival_us, custom_mode=number)]

    def _text(self, _name: str, row: Row) -> list[Event]:
        vehicle_type = VEHICLE_TYPES.get(str(row["Message"]).partition(" ")[0])
        if vehicle_type is None:
            return []
        autopilot = mav.MAV_AUTOPILOT_ARDUPILOTMEGA
        return [Heartbeat(self._vehicle.id, self._arrival_us, autopilot, vehicle_type)]


def _identity(window: Window) -> tuple[int, int]:
    """The system id, 1 unless a parameter says so, and Unix time minus time since boot, in us.

    Both are near the log's beginning, if it has them.
    """
    system_id: int | None = None
    unix_us: int | None = None
    for name, row in filter(None, messages(window, ("PARM", "GPS"))):
        try:
            if unix_us is None and name == "GPS":
                unix_us = _unix_us(row)
            elif system_id is None and name == "PARM" and row["Name"] in SYSTEM_ID:
                system_id = _system_id(row["Value"])
        except (LookupError, TypeError, ValueError, OverflowError):
            continue  # garbage; another one may be sound
        if system_id is not None and unix_us is not None:
            break
    return system_id or 1, unix_us or 0


def _system_id(value: float) -> int | None:
    return int(value) if 1 <= value <= 255 else None


def _unix_us(row: Row) -> int | None:
    """Unix time minus time since boot; None if the receiver did not know the week yet."""
    is_modern = "GWk" in row
    week = row["GWk"] if is_modern else row["Week"]
    week_ms = row["GMS"] if is_modern else row["TimeMS"]
    if week <= 0:
        return None
    if week > LAST_WEEK:
        raise ValueError(week)
    unix_s = GPS_EPOCH_S + week * WEEK_S + week_ms * 1e-3 - LEAP_SECONDS
    return int(unix_s * 1e6) - _time_us("GPS", row)[1]


def _time_us(name: str, row: Row) -> tuple[TimeField, int]:
    """The message's clock, and its time since boot.

    Raises:
        LookupError, TypeError, ValueError, OverflowError: it has none to believe.
    """
    if "TimeUS" in row:
        field, raw_us = TimeField.TIME_USEC, int(row["TimeUS"])
    elif name == "GPS":
        field, raw_us = TimeField.BOOT_MS, int(row["T"]) * 1000  # its TimeMS is the GPS week's
    else:
        field, raw_us = TimeField.BOOT_MS, int(row["TimeMS"]) * 1000
    if not 0 <= raw_us <= LONGEST_UPTIME_US:
        raise ValueError(raw_us)
    return field, raw_us


def _instance(row: Row, field: str) -> int:
    return int(row.get(field, 0))


def _from_degrees(row: Row) -> Quaternion | None:
    roll_rad, pitch_rad, yaw_rad = (math.radians(row[name]) for name in ("Roll", "Pitch", "Yaw"))
    return quaternion_from_euler(roll_rad, pitch_rad, yaw_rad)


def _from_quaternion(row: Row) -> Quaternion | None:
    return unit_or_none((row["Q1"], row["Q2"], row["Q3"], row["Q4"]))
