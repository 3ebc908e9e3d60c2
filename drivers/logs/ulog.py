"""PX4's on-board logs (.ulg).

Topics: sensor_combined, or vehicle_imu where that is missing, with
vehicle_magnetometer; vehicle_attitude as the autopilot's reference and
vehicle_attitude_groundtruth as truth; vehicle_local_position and
vehicle_gps_position (or sensor_gps) for velocity and position; estimator_status and
estimator_selector_status for how far the filter believes itself. All are SI and
FRD/NED already, fields in gauss, times in us since boot.
"""

from collections.abc import Callable, Iterator
from typing import Literal

from drivers.events import Event, Heartbeat, Malformed, Parameter, Rejected, VehicleId
from drivers.logs.log_file import Buffer, LogFile, whole_file
from drivers.logs.logged_vehicle import LoggedVehicle
from drivers.logs.ulog_format import LATEST_US, TIMES, Row, Table, UlogReader
from drivers.mavlink.constants import GPS_FIX_TYPE_3D_FIX, MAV_AUTOPILOT_PX4
from drivers.samples.fix import Fix
from drivers.samples.navigation import filter_status
from drivers.samples.rotation import unit_or_none
from drivers.samples.vehicle_clock import TimeField
from estimator.errors import InputError
from estimator.reasons import Reason
from estimator.types import Quaternion, Vec3

IMU_TOPICS = ("sensor_combined", "vehicle_imu")  # the first that is there is used
MAG_TOPICS = ("vehicle_magnetometer", "sensor_mag")
TRUTH_TOPIC = "vehicle_attitude_groundtruth"
GPS_TOPICS = ("vehicle_gps_position", "sensor_gps")
GPS_FIELDS = (
    *("fix_type", "time_utc_usec", "vel_n_m_s", "vel_e_m_s", "vel_d_m_s", "s_variance_m_s"),
    *("latitude_deg", "longitude_deg", "altitude_msl_m"),
    *("lat", "lon", "alt"),  # until 2023
)
FIELDS = {
    "sensor_combined": ("gyro_rad", "accelerometer_m_s2"),
    "vehicle_imu": ("delta_angle", "delta_velocity", "delta_angle_dt", "delta_velocity_dt"),
    "vehicle_magnetometer": ("magnetometer_ga",),
    "sensor_mag": ("x", "y", "z"),
    "vehicle_attitude": ("q",),
    TRUTH_TOPIC: ("q",),
    "vehicle_local_position": ("vx", "vy", "vz", "v_xy_valid", "v_z_valid", "dead_reckoning"),
    "estimator_status": ("solution_status_flags", "vel_test_ratio"),
    "estimator_selector_status": ("primary_instance",),
    "vehicle_gps_position": GPS_FIELDS,
    "sensor_gps": GPS_FIELDS,
}
WANTED = {topic: frozenset((*TIMES, *fields)) for topic, fields in FIELDS.items()}
LONGEST_LOG_US = 7 * 86_400 * 1_000_000  # times further from the log's middle are garbage


class Ulog(LogFile):
    """A ULog as events in the order of their times; each iteration reads the file anew.

    Arrival times are the log's own times, on Unix time where a GPS gave it
    and counted from boot otherwise.

    Raises:
        InputError: from the iteration, if the log takes a newer reader, or is a trap for one.
    """

    def __iter__(self) -> Iterator[Event]:
        with whole_file(self.path) as data:
            try:
                log = UlogReader(data, WANTED)
            except ValueError as error:
                raise InputError(f"{self.path}: cannot read this ULog, {error}") from error
            tables = _choose_tables(log.tables)
            decoder = _Decoder(log.parameters, _unix_offset_us(data, tables))
            yield from decoder.head(_begin_us(tables), log.unreadable)
            for raw_us, topic, index in _in_time_order(tables):
                yield from decoder.decode(raw_us, topic, tables[topic].row(data, index))


class _Decoder:
    """Rows of topics in, events out."""

    def __init__(self, parameters: dict[str, float], unix_us: int) -> None:
        self._parameters = parameters
        system_id = _in_byte(parameters.get("MAV_SYS_ID"), 1)
        self._vehicle = LoggedVehicle(VehicleId(system_id, 1), unix_us)
        self._is_first_filter = True
        self._handlers: dict[str, Callable[[str, int, Row], list[Event]]] = {
            "sensor_combined": self._sensor_combined,
            "vehicle_imu": self._vehicle_imu,
            "vehicle_magnetometer": self._vehicle_magnetometer,
            "sensor_mag": self._sensor_mag,
            "vehicle_attitude": self._attitude,
            TRUTH_TOPIC: self._attitude,
            "vehicle_local_position": self._local_position,
            "estimator_status": self._estimator_status,
            "estimator_selector_status": self._selector_status,
            "vehicle_gps_position": self._gps,
            "sensor_gps": self._gps,
        }

    def head(self, begin_us: int, unreadable: int) -> Iterator[Event]:
        """The events of the log's head: the vehicle, and its parameters."""
        arrival_us = self._vehicle.arrival_us(begin_us)
        if unreadable:
            yield Malformed(arrival_us, unreadable)
        vehicle_type = _in_byte(self._parameters.get("MAV_TYPE"), 0)
        yield Heartbeat(self._vehicle.id, arrival_us, MAV_AUTOPILOT_PX4, vehicle_type)
        for name, value in self._parameters.items():
            yield Parameter(self._vehicle.id, arrival_us, name, value)

    def decode(self, raw_us: int, topic: str, row: Row) -> list[Event]:
        """The events of a row; a field that is missing in this firmware's topic is 0."""
        try:
            return self._handlers[topic](topic, raw_us, row)
        except (LookupError, TypeError, ValueError):  # a field of that name, but of another kind
            return [Malformed(self._vehicle.arrival_us(raw_us), 1)]

    def _sensor_combined(self, topic: str, raw_us: int, row: Row) -> list[Event]:
        gyr = _vector(row, "gyro_rad[{}]")
        acc = _vector(row, "accelerometer_m_s2[{}]")
        return self._vehicle.imu(topic, TimeField.TIME_USEC, raw_us, gyr, acc)

    def _vehicle_imu(self, topic: str, raw_us: int, row: Row) -> list[Event]:
        angle_s, velocity_s = row["delta_angle_dt"] * 1e-6, row["delta_velocity_dt"] * 1e-6
        if angle_s <= 0 or velocity_s <= 0:
            arrival_us = self._vehicle.arrival_us(raw_us)
            return [Rejected(self._vehicle.id, arrival_us, Reason.NO_INTERVAL, topic)]
        turn, push = _vector(row, "delta_angle[{}]"), _vector(row, "delta_velocity[{}]")
        gyr = (turn[0] / angle_s, turn[1] / angle_s, turn[2] / angle_s)
        acc = (push[0] / velocity_s, push[1] / velocity_s, push[2] / velocity_s)
        return self._vehicle.imu(topic, TimeField.TIME_USEC, raw_us, gyr, acc)

    def _vehicle_magnetometer(self, _topic: str, raw_us: int, row: Row) -> list[Event]:
        self._vehicle.put_mag(_vector(row, "magnetometer_ga[{}]"), raw_us)
        return []

    def _sensor_mag(self, _topic: str, raw_us: int, row: Row) -> list[Event]:
        self._vehicle.put_mag((row["x"], row["y"], row["z"]), raw_us)
        return []

    def _attitude(self, topic: str, raw_us: int, row: Row) -> list[Event]:
        source: Literal["autopilot", "sim"] = "sim" if topic == TRUTH_TOPIC else "autopilot"
        q = _quaternion(row)
        return self._vehicle.attitude(topic, TimeField.TIME_USEC, raw_us, source, q)

    def _local_position(self, topic: str, raw_us: int, row: Row) -> list[Event]:
        if not row["v_xy_valid"] or row.get("dead_reckoning"):
            return []  # a reckoning from the same IMU tells nothing of that
        has_vertical = bool(row["v_z_valid"])
        velocity = (row["vx"], row["vy"], row["vz"] if has_vertical else 0.0)
        fix = Fix(velocity, has_vertical=has_vertical)
        return self._vehicle.fix(topic, TimeField.TIME_USEC, raw_us, fix)

    def _estimator_status(self, _topic: str, raw_us: int, row: Row) -> list[Event]:
        """The first filter's, where several run; it counts while that one is in use."""
        if self._is_first_filter and "solution_status_flags" in row:
            compass = row.get("mag_test_ratio", 0.0)
            status = filter_status(row["solution_status_flags"], row["vel_test_ratio"], compass)
            return self._vehicle.filter_says(status, raw_us)
        return []

    def _selector_status(self, _topic: str, _raw_us: int, row: Row) -> list[Event]:
        self._is_first_filter = row["primary_instance"] == 0
        if not self._is_first_filter:
            self._vehicle.navigation.forget()
        return []

    def _gps(self, topic: str, raw_us: int, row: Row) -> list[Event]:
        if row["fix_type"] < GPS_FIX_TYPE_3D_FIX:
            return []
        velocity = (row["vel_n_m_s"], row["vel_e_m_s"], row["vel_d_m_s"])
        sigma_m_s = row.get("s_variance_m_s") or None  # zero where it is unknown
        fix = Fix(velocity, sigma_m_s=sigma_m_s, position=_position(row))
        return self._vehicle.fix(topic, TimeField.TIME_USEC, raw_us, fix)


def _choose_tables(tables: dict[str, Table]) -> dict[str, Table]:
    """The tables to read: one topic a purpose, and such as have rows."""
    found = {name: table for name, table in tables.items() if table.times_us}
    for choice in (IMU_TOPICS, MAG_TOPICS, GPS_TOPICS):
        present = [name for name in choice if name in found]
        for name in present[1:]:
            del found[name]
    return found


def _in_time_order(tables: dict[str, Table]) -> Iterator[tuple[int, str, int]]:
    """(time in us, topic, row) of all rows; at equal times the IMU comes last."""
    import numpy as np

    names = sorted(tables, key=lambda name: name in IMU_TOPICS)
    if not names:
        return
    columns = [np.array(tables[name].times_us, np.int64) for name in names]
    times_us = np.concatenate(columns)
    topics = np.repeat(np.arange(len(names)), [len(column) for column in columns])
    rows = np.concatenate([np.arange(len(column)) for column in columns])
    sane = np.flatnonzero(np.abs(times_us - int(np.median(times_us))) < LONGEST_LOG_US)
    for index in sane[np.argsort(times_us[sane], kind="stable")]:
        yield int(times_us[index]), names[topics[index]], int(rows[index])


def _vector(row: Row, field: str) -> Vec3:
    return (row[field.format(0)], row[field.format(1)], row[field.format(2)])


def _quaternion(row: Row) -> Quaternion | None:
    return unit_or_none((row["q[0]"], row["q[1]"], row["q[2]"], row["q[3]"]))


def _position(row: Row) -> Vec3:
    """Latitude and longitude in degrees, altitude in m; until 2023 in 1e-7 degrees and mm."""
    if "latitude_deg" in row:
        return row["latitude_deg"], row["longitude_deg"], row["altitude_msl_m"]
    return row["lat"] * 1e-7, row["lon"] * 1e-7, row["alt"] * 1e-3


def _begin_us(tables: dict[str, Table]) -> int:
    return min((table.times_us[0] for table in tables.values()), default=0)


def _unix_offset_us(data: Buffer, tables: dict[str, Table]) -> int:
    """Unix time minus time since boot, from the first GPS row that knows it; 0 without."""
    for table in (tables[name] for name in GPS_TOPICS if name in tables):
        for index, time_us in enumerate(table.times_us):
            row = table.row(data, index)
            if 0 < row.get("time_utc_usec", 0) < LATEST_US:
                return int(row["time_utc_usec"]) - time_us
    return 0


def _in_byte(value: float | None, default: int) -> int:
    return int(value) if value is not None and 0 < value <= 255 else default
