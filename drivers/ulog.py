"""PX4's on-board logs (.ulg), read by pyulog.

Topics: sensor_combined, or vehicle_imu where that is missing, with
vehicle_magnetometer; vehicle_attitude as the autopilot's reference and
vehicle_attitude_groundtruth as truth; vehicle_local_position and
vehicle_gps_position (or sensor_gps) for velocity and position. All are SI and
FRD/NED already, fields in gauss, times in us since boot.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import SEEK_CUR, SEEK_SET, BufferedReader, FileIO, StringIO
from pathlib import Path
from typing import Any, Literal

from drivers.events import (
    Event,
    Heartbeat,
    Imu,
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
    AUTOPILOT_PX4,
    FILTER_VELOCITY_SIGMA_M_S,
    FIX_3D,
    GPS_VELOCITY_SIGMA_M_S,
    unit_or_none,
)
from drivers.vehicle_clock import Placed, Refused, TimeField, VehicleClock
from estimator.errors import InputError
from estimator.types import Vec3, VelocitySample

IMU_TOPICS = ("sensor_combined", "vehicle_imu")  # the first that is there is used
MAG_TOPICS = ("vehicle_magnetometer", "sensor_mag")
GPS_TOPICS = ("vehicle_gps_position", "sensor_gps")
MOST_RETURNS = 1000  # of the reader to bytes that it has seen; looking for a sync takes a few
LONGEST_LOG_US = 7 * 86_400 * 1_000_000  # times further from the log's start are garbage

Row = Callable[[str], float]  # the value of a field in one row of a topic


class Ulog(LogFile):
    """A ULog as events in the order of their times; each iteration reads the file anew.

    Arrival times are the log's own times, on Unix time where a GPS gave it
    and counted from boot otherwise.

    Raises:
        InputError: from the iteration, if nothing in the file can be read.
    """

    def __iter__(self) -> Iterator[Event]:
        log = _load(self.path)
        topics = _topics(log)
        decoder = _Decoder(log, topics)
        yield from decoder.head()
        for raw_us, topic, row in _in_time_order(topics, log.start_timestamp):
            yield from decoder.decode(raw_us, topic, row)


class _Decoder:
    """Rows of topics in, events out."""

    def __init__(self, log: Any, topics: dict[str, dict[str, Any]]) -> None:
        self._parameters: dict[str, float] = {
            name: float(value)
            for name, value in log.initial_parameters.items()
            if isinstance(value, (int, float))  # bytes where the file is damaged
        }
        self._vehicle = VehicleId(_in_byte(self._parameters.get("MAV_SYS_ID"), 1), 1)
        self._unix_us = _unix_offset_us(topics)
        self._start_us = log.start_timestamp
        self._clock = VehicleClock()
        self._log_time = LogTime()
        self._field = FreshField()
        self._plausibility: defaultdict[str, Plausibility] = defaultdict(Plausibility)
        self._handlers: dict[str, Callable[[int, str, Row], list[Event]]] = {
            "sensor_combined": self._sensor_combined,
            "vehicle_imu": self._vehicle_imu,
            "vehicle_magnetometer": self._vehicle_magnetometer,
            "sensor_mag": self._sensor_mag,
            "vehicle_attitude": self._attitude,
            "vehicle_attitude_groundtruth": self._truth,
            "vehicle_local_position": self._local_position,
            "vehicle_gps_position": self._gps,
            "sensor_gps": self._gps,
        }

    def head(self) -> Iterator[Event]:
        """What the log's head says: who it is, and its parameters."""
        arrival_us = self._unix_us + self._start_us
        vehicle_type = _in_byte(self._parameters.get("MAV_TYPE"), 0)
        yield Heartbeat(self._vehicle, arrival_us, AUTOPILOT_PX4, vehicle_type)
        for name, value in self._parameters.items():
            yield Parameter(self._vehicle, arrival_us, name, value)

    def decode(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        return self._handlers[topic](raw_us, topic, row)

    def _arrival(self, raw_us: int) -> int:
        return self._unix_us + raw_us

    def _other(self, raw_us: int, topic: str) -> Placed | Refused:
        return self._clock.other(
            topic, TimeField.TIME_USEC, raw_us, self._log_time.arrival_us(raw_us)
        )

    def _sensor_combined(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        gyr = _vector(row, "gyro_rad[{}]")
        acc = _vector(row, "accelerometer_m_s2[{}]")
        return self._imu(raw_us, topic, gyr, acc)

    def _vehicle_imu(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        angle_s, velocity_s = row("delta_angle_dt") * 1e-6, row("delta_velocity_dt") * 1e-6
        if angle_s <= 0 or velocity_s <= 0:
            return [Rejected(self._vehicle, self._arrival(raw_us), "no_interval", topic)]
        turn, push = _vector(row, "delta_angle[{}]"), _vector(row, "delta_velocity[{}]")
        gyr = (turn[0] / angle_s, turn[1] / angle_s, turn[2] / angle_s)
        acc = (push[0] / velocity_s, push[1] / velocity_s, push[2] / velocity_s)
        return self._imu(raw_us, topic, gyr, acc)

    def _imu(self, raw_us: int, topic: str, gyr: Vec3, acc: Vec3) -> list[Event]:
        arrival_us = self._arrival(raw_us)
        refusal = refuse_imu(gyr, acc)
        if refusal is not None:
            return [Rejected(self._vehicle, arrival_us, refusal, topic)]
        placed = self._clock.imu(
            topic, TimeField.TIME_USEC, raw_us, self._log_time.arrival_us(raw_us)
        )
        if isinstance(placed, Refused):
            return [Rejected(self._vehicle, arrival_us, placed.reason, topic)]
        sample = self._field.sample(topic, raw_us, placed.time_us, gyr, acc)
        return [
            Imu(self._vehicle, arrival_us, placed.boot_us, topic, sample),
            *(
                Notice(self._vehicle, arrival_us, f"{topic}: {text}")
                for text in self._plausibility[topic].look(sample, AUTOPILOT_PX4)
            ),
        ]

    def _vehicle_magnetometer(self, raw_us: int, _topic: str, row: Row) -> list[Event]:
        self._field.put(_vector(row, "magnetometer_ga[{}]"), raw_us)
        return []

    def _sensor_mag(self, raw_us: int, _topic: str, row: Row) -> list[Event]:
        self._field.put((row("x"), row("y"), row("z")), raw_us)
        return []

    def _attitude(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        return self._reference(raw_us, topic, row, "autopilot")

    def _truth(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        return self._reference(raw_us, topic, row, "sim")

    def _reference(
        self, raw_us: int, topic: str, row: Row, source: Literal["autopilot", "sim"]
    ) -> list[Event]:
        q = unit_or_none((row("q[0]"), row("q[1]"), row("q[2]"), row("q[3]")))
        placed = self._other(raw_us, topic)
        if q is None or isinstance(placed, Refused):
            return []
        arrival_us = self._arrival(raw_us)
        return [ReferenceAttitude(self._vehicle, arrival_us, placed.time_us, source, topic, q)]

    def _local_position(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        if not row("v_xy_valid"):
            return []
        has_vertical = bool(row("v_z_valid"))
        velocity = (row("vx"), row("vy"), row("vz") if has_vertical else 0.0)
        return self._velocity(raw_us, topic, velocity, has_vertical, FILTER_VELOCITY_SIGMA_M_S)

    def _gps(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        if row("fix_type") < FIX_3D:
            return []
        velocity = (row("vel_n_m_s"), row("vel_e_m_s"), row("vel_d_m_s"))
        sigma_m_s = row("s_variance_m_s") or GPS_VELOCITY_SIGMA_M_S
        return [
            *self._position(raw_us, topic, row),
            *self._velocity(raw_us, topic, velocity, True, sigma_m_s),
        ]

    def _position(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        placed = self._other(raw_us, f"{topic} position")
        if isinstance(placed, Refused):
            return []
        arrival_us = self._arrival(raw_us)
        return [Position(self._vehicle, arrival_us, placed.time_us, topic, *_fix(row))]

    def _velocity(
        self, raw_us: int, topic: str, velocity: Vec3, has_vertical: bool, sigma_m_s: float
    ) -> list[Event]:
        placed = self._other(raw_us, topic)
        if isinstance(placed, Refused) or not all(map(math.isfinite, velocity)):
            return []
        sample = VelocitySample(placed.time_us, velocity, has_vertical, sigma_m_s)
        return [Velocity(self._vehicle, self._arrival(raw_us), topic, sample)]


class _AdvancingReader(BufferedReader):
    """A file whose reader may not step back over the same bytes for ever.

    pyulog steps back by a message's whole length after it has read less, at a damaged
    file's end, and so returns to where it was.
    """

    def __init__(self, raw: FileIO) -> None:
        super().__init__(raw)
        self._furthest = 0
        self._returns = 0

    def seek(self, target: int, whence: int = SEEK_SET, /) -> int:
        """Raises ``EOFError`` when stepping back has led nowhere too often."""
        position = super().seek(target, whence)
        if whence == SEEK_CUR:
            self._returns = self._returns + 1 if position <= self._furthest else 0
            self._furthest = max(self._furthest, position)
            if self._returns > MOST_RETURNS:
                raise EOFError
        return position


def _load(path: Path) -> Any:
    """Pyulog's log; it prints, and raises whatever a damaged file makes it run into."""
    names = [
        *IMU_TOPICS,
        *MAG_TOPICS,
        *GPS_TOPICS,
        "vehicle_attitude",
        "vehicle_attitude_groundtruth",
        "vehicle_local_position",
    ]
    try:
        with (
            redirect_stdout(StringIO()),
            redirect_stderr(StringIO()),
            _AdvancingReader(FileIO(path)) as file,
        ):
            from pyulog import ULog

            return ULog(file, names)
    except Exception as error:  # see above
        raise InputError(f"{path}: damaged ULog, its definitions make no sense") from error


def _topics(log: Any) -> dict[str, dict[str, Any]]:
    """The columns of the topics to read: one topic a purpose, first instances."""
    found = {data.name: data.data for data in log.data_list if data.multi_id == 0}
    for choice in (IMU_TOPICS, MAG_TOPICS, GPS_TOPICS):
        present = [name for name in choice if name in found]
        for name in present[1:]:
            del found[name]
    return found


def _in_time_order(
    topics: dict[str, dict[str, Any]], start_us: int
) -> Iterator[tuple[int, str, Row]]:
    """(time in us, topic, row) of all rows; at equal times the IMU comes last."""
    import numpy as np

    names = sorted(topics, key=lambda name: name in IMU_TOPICS)
    tables = [_Table(topics[name]) for name in names]
    times_us = np.concatenate([table.time_us for table in tables] or [np.empty(0, np.int64)])
    sources = np.repeat(np.arange(len(tables)), [len(table.time_us) for table in tables])
    rows = np.concatenate([np.arange(len(table.time_us)) for table in tables] or [times_us])
    sane = np.abs(times_us - start_us) < LONGEST_LOG_US
    for index in np.flatnonzero(sane)[np.argsort(times_us[sane], kind="stable")].tolist():
        source = sources[index]
        yield int(times_us[index]), names[source], tables[source].row(int(rows[index]))


class _Table:
    """One topic: its times, and its rows by field name."""

    def __init__(self, columns: dict[str, Any]) -> None:
        import numpy as np

        stamps = columns["timestamp"]
        sampled = columns.get("timestamp_sample", stamps)
        self.time_us = np.where(sampled > 0, sampled, stamps).astype(np.int64)
        self._columns = {name: values.tolist() for name, values in columns.items()}

    def row(self, index: int) -> Row:
        def value(name: str) -> float:
            column = self._columns.get(name)
            return 0.0 if column is None else column[index]

        return value


def _vector(row: Row, field: str) -> Vec3:
    return (row(field.format(0)), row(field.format(1)), row(field.format(2)))


def _fix(row: Row) -> tuple[float, float, float]:
    """Latitude and longitude in degrees, altitude in m; until 2023 in 1e-7 degrees and mm."""
    if row("latitude_deg") or row("longitude_deg"):
        return row("latitude_deg"), row("longitude_deg"), row("altitude_msl_m")
    return row("lat") * 1e-7, row("lon") * 1e-7, row("alt") * 1e-3


def _unix_offset_us(topics: dict[str, dict[str, Any]]) -> int:
    """Unix time minus time since boot, from the first GPS row that knows it; 0 without."""
    for name in GPS_TOPICS:
        columns = topics.get(name)
        if columns is None or "time_utc_usec" not in columns:
            continue
        for stamp_us, utc_us in zip(columns["timestamp"], columns["time_utc_usec"], strict=True):
            if utc_us > 0:
                return int(utc_us) - int(stamp_us)
    return 0


def _in_byte(value: float | None, default: int) -> int:
    return int(value) if value is not None and 0 < value <= 255 else default
