"""ArduPilot's on-board logs (DataFlash .bin), read by pymavlink's DFReader.

The messages read, with the names of both eras: IMU, IMU2, IMU3 (or the field
I), MAG, ATT, XKQ/NKQ, XKF1/NKF1/EKF1, GPS, PARM, MSG, and SIM as truth.
Accelerometer and gyroscope are SI in the log, the field is in mGauss, angles
are in degrees. Times count from boot, in us or, until 2015, in ms.
"""

import math
import mmap
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from itertools import islice
from pathlib import Path
from typing import Any

from drivers.events import (
    ClockReset,
    Event,
    Heartbeat,
    Imu,
    Malformed,
    Notice,
    Parameter,
    Position,
    ReferenceAttitude,
    Rejected,
    VehicleId,
    Velocity,
)
from drivers.fresh_field import FreshField
from drivers.imu_checks import Plausibility, refuse_imu
from drivers.log_file import LogFile
from drivers.log_time import LogTime
from drivers.mavlink_codec import (
    FILTER_VELOCITY_SIGMA_M_S,
    FIX_3D,
    GPS_VELOCITY_SIGMA_M_S,
    mavlink,
    quaternion_from_euler,
    unit_or_none,
)
from drivers.vehicle_clock import Placed, Refused, TimeField, VehicleClock
from estimator.errors import InputError
from estimator.types import Quaternion, Vec3, VelocitySample

MILLIGAUSS = 1e-3
AUTOPILOT_ARDUPILOT = 3  # MAV_AUTOPILOT_ARDUPILOTMEGA
VEHICLE_TYPES = {  # the first word of MSG at start, and its MAV_TYPE
    "ArduCopter": 2,
    "ArduPlane": 1,
    "ArduRover": 10,
    "Rover": 10,
    "ArduSub": 12,
    "AntennaTracker": 5,
    "Blimp": 7,
}
ENDLESS_FORMAT = re.compile(rb"\xa3\x95\x80.[\x00-\x02]([A-Z][A-Z0-9]{1,3})", re.DOTALL)
BATCH = 1000  # messages read at a time with the output turned away
UNREADABLE_LIMIT = 10_000  # after that many unreadable messages the rest is given up


class Dataflash(LogFile):
    """A DataFlash log as events; each iteration reads the file from its start.

    The arrival times are the log's own times, on Unix time where the log has
    a GPS time and counted from boot otherwise.

    Raises:
        InputError: from the iteration, if nothing in the file can be read.
    """

    def __iter__(self) -> Iterator[Event]:
        with _opened(self.path) as reader:
            decoder = _Decoder(reader)
            for message in _messages(reader, decoder.message_names):
                yield from decoder.decode(message)


class _Decoder:
    """DataFlash messages in, events out."""

    def __init__(self, reader: Any) -> None:
        # DFReader has read the parameters; its time base is Unix time minus time since boot
        self._vehicle = VehicleId(_system_id(reader.params), 1)
        self._unix_us = int(reader.clock.timebase * 1e6)
        self._clock = VehicleClock()
        self._log_time = LogTime()
        self._field = FreshField()
        self._plausibility: defaultdict[str, Plausibility] = defaultdict(Plausibility)
        self._arrival_us = self._unix_us
        self._resets: list[Event] = []  # of the message in hand
        self._handlers: dict[str, Callable[[Any], list[Event]]] = {
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
            "GPS": self._gps,
            "SIM": self._truth,
            "PARM": self._parameter,
            "MSG": self._text,
        }

    @property
    def message_names(self) -> list[str]:
        return list(self._handlers)

    def decode(self, message: Any | None) -> list[Event]:
        """The events of a message; None stands for one that could not be read."""
        if message is None:
            return [Malformed(self._arrival_us, 1)]
        self._resets.clear()
        try:
            events = self._handlers[message.get_type()](message)
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError):
            # a message of that name with other columns, or a column with garbage in it
            return [Malformed(self._arrival_us, 1)]
        return [*self._resets, *events]

    def _place(self, m: Any, name: str, *, imu: bool = False) -> tuple[Placed | Refused, int]:
        """The message's place in time, and its raw time in us."""
        raw_us, field = _time_us(m)
        self._arrival_us = self._unix_us + raw_us
        place = self._clock.imu if imu else self._clock.other
        placed = place(name, field, raw_us, self._log_time.arrival_us(raw_us))
        if isinstance(placed, Placed) and placed.reset is not None:
            reset = placed.reset
            self._resets.append(
                ClockReset(self._vehicle, self._arrival_us, reset.reason, reset.step_us * 1e-6)
            )
        return placed, raw_us

    def _imu(self, m: Any) -> list[Event]:
        name = _imu_name(m)
        gyr = (float(m.GyrX), float(m.GyrY), float(m.GyrZ))
        acc = (float(m.AccX), float(m.AccY), float(m.AccZ))
        refusal = refuse_imu(gyr, acc)
        if refusal is not None:
            return [Rejected(self._vehicle, self._arrival_us, refusal, name)]
        placed, raw_us = self._place(m, name, imu=True)
        if isinstance(placed, Refused):
            return [Rejected(self._vehicle, self._arrival_us, placed.reason, name)]
        sample = self._field.sample(name, raw_us, placed.time_us, gyr, acc)
        events: list[Event] = [Imu(self._vehicle, self._arrival_us, placed.boot_us, name, sample)]
        events.extend(
            Notice(self._vehicle, self._arrival_us, f"{name}: {text}")
            for text in self._plausibility[name].look(sample, AUTOPILOT_ARDUPILOT)
        )
        return events

    def _mag(self, m: Any) -> list[Event]:
        if _instance(m, "I") == 0:
            mag = (m.MagX * MILLIGAUSS, m.MagY * MILLIGAUSS, m.MagZ * MILLIGAUSS)
            self._field.put(mag, _time_us(m)[0])
        return []

    def _attitude(self, m: Any) -> list[Event]:
        return self._reference(m, "autopilot", _from_degrees(m))

    def _attitude_quaternion(self, m: Any) -> list[Event]:
        if _instance(m, "C") != 0:
            return []
        return self._reference(m, "autopilot", unit_or_none((m.Q1, m.Q2, m.Q3, m.Q4)))

    def _truth(self, m: Any) -> list[Event]:
        has_quaternion = "Q1" in m.get_fieldnames()
        q = unit_or_none((m.Q1, m.Q2, m.Q3, m.Q4)) if has_quaternion else _from_degrees(m)
        return self._reference(m, "sim", q)

    def _reference(self, m: Any, source: Any, q: Quaternion | None) -> list[Event]:
        name = m.get_type()
        placed, _ = self._place(m, name)
        if q is None or isinstance(placed, Refused):
            return []
        return [ReferenceAttitude(self._vehicle, self._arrival_us, placed.time_us, source, name, q)]

    def _filter_velocity(self, m: Any) -> list[Event]:
        if _instance(m, "C") != 0:
            return []
        return self._velocity(m, (m.VN, m.VE, m.VD), True, FILTER_VELOCITY_SIGMA_M_S)

    def _gps(self, m: Any) -> list[Event]:
        if m.Status < FIX_3D or _instance(m, "I") != 0 or (m.Lat == 0 and m.Lng == 0):
            return []
        course_rad = math.radians(m.GCrs)
        has_vertical = "VZ" in m.get_fieldnames()
        down_m_s = m.VZ if has_vertical else 0.0
        velocity = (m.Spd * math.cos(course_rad), m.Spd * math.sin(course_rad), down_m_s)
        events = self._velocity(m, velocity, has_vertical, GPS_VELOCITY_SIGMA_M_S)
        if not events or not isinstance(events[0], Velocity):
            return events
        time_us = events[0].sample.time_us
        position = Position(self._vehicle, self._arrival_us, time_us, "GPS", m.Lat, m.Lng, m.Alt)
        return [position, *events]

    def _velocity(
        self, m: Any, velocity: Vec3, has_vertical: bool, sigma_m_s: float
    ) -> list[Event]:
        name = m.get_type()
        placed, _ = self._place(m, name)
        if isinstance(placed, Refused) or not all(map(math.isfinite, velocity)):
            return []
        sample = VelocitySample(placed.time_us, velocity, has_vertical, sigma_m_s)
        return [Velocity(self._vehicle, self._arrival_us, name, sample)]

    def _parameter(self, m: Any) -> list[Event]:
        return [Parameter(self._vehicle, self._arrival_us, m.Name, float(m.Value))]

    def _text(self, m: Any) -> list[Event]:
        vehicle_type = VEHICLE_TYPES.get(str(m.Message).partition(" ")[0])
        if vehicle_type is None:
            return []
        return [Heartbeat(self._vehicle, self._arrival_us, AUTOPILOT_ARDUPILOT, vehicle_type)]


def _time_us(m: Any) -> tuple[int, TimeField]:
    """The message's time since boot, and its clock."""
    names = m.get_fieldnames()
    if "TimeUS" in names:
        return int(m.TimeUS), TimeField.TIME_USEC
    if m.get_type() == "GPS":
        return int(m.T) * 1000, TimeField.BOOT_MS  # its TimeMS is the GPS week's
    return int(m.TimeMS) * 1000, TimeField.BOOT_MS


def _instance(m: Any, field: str) -> int:
    return int(getattr(m, field)) if field in m.get_fieldnames() else 0


def _imu_name(m: Any) -> str:
    """IMU, IMU2, IMU3: as old logs call them; newer ones number them from 0 in a field."""
    instance = _instance(m, "I")
    return f"IMU{instance + 1}" if instance else str(m.get_type())


def _from_degrees(m: Any) -> Quaternion | None:
    return quaternion_from_euler(math.radians(m.Roll), math.radians(m.Pitch), math.radians(m.Yaw))


def _system_id(parameters: dict[str, Any]) -> int:
    value = parameters.get("MAV_SYSID", parameters.get("SYSID_THISMAV", 1))
    return int(value) if isinstance(value, (int, float)) and 1 <= value <= 255 else 1


def _refuse_endless_formats(path: Path) -> None:
    """DFReader never comes back from a message format shorter than a message's head."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        endless = ENDLESS_FORMAT.search(data)
        if endless is not None:
            name = endless[1].decode()
            raise InputError(f"{path}: damaged DataFlash log (impossible length of {name})")


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """DFReader's reader; it is as talkative as it is fragile on damaged files."""
    _refuse_endless_formats(path)
    mavlink()  # sets what pymavlink reads from the environment
    os.environ["PYMAVLINK_FAST_INDEX"] = "0"  # the C indexer prints past sys.stderr
    from pymavlink.DFReader import DFReader_binary

    reader: Any = DFReader_binary.__new__(DFReader_binary)  # to close what a failure leaves open
    with _quiet():
        try:
            reader.__init__(str(path))
        except Exception as error:  # it raises whatever its tables run into
            if hasattr(reader, "filehandle"):
                reader.filehandle.close()
            raise InputError(
                f"{path}: damaged DataFlash log, its message formats make no sense"
            ) from error
    try:
        yield reader
    finally:
        reader.close()


def _messages(reader: Any, names: list[str]) -> Iterator[Any | None]:
    """The messages of those names in the file's order, None for each unreadable one."""
    unreadable = 0
    messages = _next_messages(reader, names)
    while True:
        with _quiet():
            batch = list(islice(messages, BATCH))
        yield from batch
        unreadable += batch.count(None)
        if len(batch) < BATCH or unreadable > UNREADABLE_LIMIT:
            return


def _next_messages(reader: Any, names: list[str]) -> Iterator[Any | None]:
    """By DFReader's index, then one by one behind the damage that ended the index, if any."""
    yield from _until_none(lambda: reader.recv_match(type=names))
    reader.offset = _end_of_index(reader)
    reader.remaining = reader.data_len - reader.offset
    for message in _until_none(reader.recv_msg):
        if message is None or message.get_type() in names:
            yield message


def _until_none(receive: Callable[[], Any]) -> Iterator[Any | None]:
    """What ``receive`` gives until it gives None; None here stands for an exception."""
    while True:
        try:
            message = receive()
        except Exception:  # noqa: BLE001 - likewise; it has moved on by then
            yield None
            continue
        if message is None:
            return
        yield message


def _end_of_index(reader: Any) -> int:
    """Where the last message that DFReader indexed ends; it gives up at the first unknown type."""
    last = max((offsets[-1] for offsets in reader.offsets if offsets), default=0)
    form = reader.formats.get(reader.data_map[last + 2]) if last + 2 < reader.data_len else None
    return min(last + (form.len if form else 3), int(reader.data_len))


@contextmanager
def _quiet() -> Iterator[None]:
    with (
        open(os.devnull, "w", encoding="utf-8") as nowhere,  # noqa: PTH123 - a device
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
        yield
