"""PX4's on-board logs (.ulg).

Topics: sensor_combined, or vehicle_imu where that is missing, with vehicle_magnetometer;
vehicle_attitude as the autopilot's reference and vehicle_attitude_groundtruth as truth;
vehicle_local_position and vehicle_gps_position (or sensor_gps) for velocity and position;
estimator_status and estimator_selector_status for how far the filter believes itself;
vehicle_status for arming. All are SI and FRD/NED already, fields in gauss, times in us since boot.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from drivers.events import Event, Heartbeat, ModeChange, Parameter, Rejected, VehicleId
from drivers.logs.log_file import LATEST_US, LogFile, windowed
from drivers.logs.logged_vehicle import LoggedVehicle
from drivers.logs.ulog_format import Found, Row, UlogReader
from drivers.mavlink.constants import GPS_FIX_TYPE_3D_FIX, MAV_AUTOPILOT_PX4
from drivers.samples.navigation import Fix
from drivers.samples.vehicle_clock import LEAST_BACK_US, REORDERED_US
from estimator.errors import InputError
from estimator.reasons import Reason

IMU_TOPICS = ("sensor_combined", "vehicle_imu")  # the first that is there is used
MAG_TOPICS = ("vehicle_magnetometer", "sensor_mag")
GPS_TOPICS = ("vehicle_gps_position", "sensor_gps")
ARMING_STATE_ARMED = 2
CHOICES = (IMU_TOPICS, MAG_TOPICS, GPS_TOPICS)
FIRST_TOPICS = {choice[0] for choice in CHOICES}
DAMAGE = ""  # stands in a topic's place
LONGEST_LOG_US = 7 * 86_400 * 1_000_000  # times further from the beginning's middle are garbage
# So many rows in order show that the clock was set back, by less than a second or by more
ROWS_BACK, ROWS_FAR_BACK = 5, 2
MOST_HELD = 1 << 14  # rows: so many later ones are known when one is used; some 10 s


class Ulog(LogFile):
    """A ULog as events in the order of their times; each iteration reads the file anew.

    Arrival times are the log's own times, on Unix time where a GPS gave it
    and counted from boot otherwise.

    Raises:
        InputError: from the iteration, if the log takes a newer reader.
    """

    def __iter__(self) -> Iterator[Event]:
        try:
            with windowed(self.path, self.on_read) as window:
                overview = _look_over(UlogReader(window, CLOCKS))
            with windowed(self.path, self.on_read) as window:
                log = UlogReader(window, {name: FIELDS[name] for name in overview.topics})
                system_id = _in_byte(overview.parameters.get("MAV_SYS_ID"), 1)
                vehicle = LoggedVehicle(VehicleId(system_id, 1), overview.unix_us)
                vehicle.at(overview.begin_us)
                about, parameters = (vehicle.id, vehicle.arrival_us), overview.parameters
                vehicle_type = _in_byte(parameters.get("MAV_TYPE"), 0)
                yield Heartbeat(*about, MAV_AUTOPILOT_PX4, vehicle_type)
                yield from (Parameter(*about, name, value) for name, value in parameters.items())
                yield from vehicle.events(_in_time_order(log.rows(), overview), _events)
        except ValueError as error:
            raise InputError(f"{self.path}: cannot read this ULog, {error}") from error


class _Overview(NamedTuple):
    """What has to be known of a log before its first row is used."""

    parameters: dict[str, float]
    # Those that are read: one a purpose, of such as have rows. At equal times they come in this
    # order, the IMU last.
    topics: tuple[str, ...]
    begin_us: int
    middle_us: int
    unix_us: int  # Unix time minus time since boot, from the first GPS row that knows it; else 0


def _events(vehicle: LoggedVehicle, found: Found) -> list[Event]:
    """The events of a row; one without a field that its topic should have is unreadable."""
    topic, row = found.topic, found.row
    vehicle.at(found.time_us)
    match topic:
        case "sensor_combined":
            return vehicle.imu(topic, row["gyro_rad"], row["accelerometer_m_s2"])
        case "vehicle_imu":
            return _vehicle_imu(vehicle, topic, row)
        case "vehicle_magnetometer":
            return vehicle.put_mag(row["magnetometer_ga"])
        case "sensor_mag":  # the driver's own
            return vehicle.put_mag((row["x"], row["y"], row["z"]))
        case "vehicle_attitude":
            return vehicle.attitude(topic, "autopilot", row["q"])
        case "vehicle_attitude_groundtruth":
            return vehicle.attitude(topic, "sim", row["q"])
        case "vehicle_status":
            is_armed = row["arming_state"] == ARMING_STATE_ARMED
            return [ModeChange(vehicle.id, vehicle.arrival_us, is_armed)]
        case "estimator_selector_status":  # the first filter's status counts while it is in use
            vehicle.uses_first_filter = row["primary_instance"] == 0
            if not vehicle.uses_first_filter:
                vehicle.intake.navigation.forget()
        case "estimator_status":
            if vehicle.uses_first_filter and "solution_status_flags" in row:
                return vehicle.filter_status(row["solution_status_flags"], row["vel_test_ratio"])
        case "vehicle_local_position":
            # a reckoning from the same IMU shows nothing of that
            if row["v_xy_valid"] and not row.get("dead_reckoning"):
                has_vertical = bool(row["v_z_valid"])
                velocity = (row["vx"], row["vy"], row["vz"] if has_vertical else 0.0)
                return vehicle.fix(topic, Fix(velocity, has_vertical=has_vertical))
        case _ if topic == DAMAGE:
            return [vehicle.malformed()]
        case _ if row["fix_type"] >= GPS_FIX_TYPE_3D_FIX:
            return _receiver_fix(vehicle, topic, row)
    return []


def _vehicle_imu(vehicle: LoggedVehicle, topic: str, row: Row) -> list[Event]:
    angle_s, velocity_s = row["delta_angle_dt"] * 1e-6, row["delta_velocity_dt"] * 1e-6
    if angle_s <= 0 or velocity_s <= 0:
        return [Rejected(vehicle.id, vehicle.arrival_us, Reason.NO_INTERVAL, topic)]
    roll, pitch, yaw = (turn / angle_s for turn in row["delta_angle"])
    x, y, z = (push / velocity_s for push in row["delta_velocity"])
    return vehicle.imu(topic, (roll, pitch, yaw), (x, y, z))


def _receiver_fix(vehicle: LoggedVehicle, topic: str, row: Row) -> list[Event]:
    velocity = (row["vel_n_m_s"], row["vel_e_m_s"], row["vel_d_m_s"])
    sigma_m_s = row.get("s_variance_m_s") or None  # zero where it is unknown
    if "latitude_deg" in row:
        position = row["latitude_deg"], row["longitude_deg"], row["altitude_msl_m"]
    else:  # until 2023
        position = row["lat"] * 1e-7, row["lon"] * 1e-7, row["alt"] * 1e-3
    return vehicle.fix(topic, Fix(velocity, sigma_m_s=sigma_m_s, position=position))


GPS = (
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
    "vehicle_attitude_groundtruth": ("q",),
    "vehicle_local_position": ("vx", "vy", "vz", "v_xy_valid", "v_z_valid", "dead_reckoning"),
    "estimator_status": ("solution_status_flags", "vel_test_ratio"),
    "estimator_selector_status": ("primary_instance",),
    "vehicle_status": ("arming_state",),
    **dict.fromkeys(GPS_TOPICS, GPS),
}
CLOCKS = dict.fromkeys(FIELDS, ("time_utc_usec",))


def _look_over(log: UlogReader) -> _Overview:
    """Read as far as needed: where a GPS shows the time, the log's beginning is enough."""
    begins_us: dict[str, int] = {}
    unix_us: dict[str, int] = {}
    times_us: list[int] = []
    for row in filter(None, log.rows()):
        begins_us.setdefault(row.topic, row.time_us)
        if row.topic in GPS_TOPICS and row.topic not in unix_us:
            utc_us = row.row.get("time_utc_usec", 0)
            if 0 < utc_us < LATEST_US:
                unix_us[row.topic] = int(utc_us) - row.time_us
        if len(times_us) < MOST_HELD:
            times_us.append(row.time_us)
        elif begins_us.keys() >= FIRST_TOPICS and GPS_TOPICS[0] in unix_us:
            break
    others = {name for each in CHOICES for name in [t for t in each if t in begins_us][1:]}
    read = (name for name in log.tables if name in begins_us.keys() - others)
    topics = sorted(read, key=lambda name: name in IMU_TOPICS)
    begin_us = min((us for name, us in begins_us.items() if name in topics), default=0)
    middle_us = sorted(times_us)[len(times_us) // 2] if times_us else 0
    clocks = [us for name, us in unix_us.items() if name in topics]
    return _Overview(log.parameters, tuple(topics), begin_us, middle_us, clocks[0] if clocks else 0)


def _in_time_order(rows: Iterable[Found | None], overview: _Overview) -> Iterator[Found]:
    """Rows in the order of their times, as far as none comes too late; then of their topics.

    Where the clock was set back the order begins anew.
    """
    rank = {topic: k for k, topic in enumerate((*overview.topics, DAMAGE))}
    held: list[tuple[int, int, int, int, Found]] = []
    for number, (epoch, row) in enumerate(_with_epochs(rows, overview)):
        held.append((epoch, row.time_us, rank[row.topic], number, row))
        if len(held) >= 2 * MOST_HELD:
            held.sort()
            yield from (each[-1] for each in held[:MOST_HELD])
            del held[:MOST_HELD]
    held.sort()
    yield from (each[-1] for each in held)


def _with_epochs(rows: Iterable[Found | None], overview: _Overview) -> Iterator[tuple[int, Found]]:
    """The rows of the log's time and where damage is, and how often the clock had been set back.

    Some rows of a topic in order, all behind what came before, show it: a single one is garbled,
    and those that a logger has written late come in no order.
    """
    epoch, at_us, behind = 0, overview.begin_us, dict[str, list[Found]]()
    latest_us = dict[str, tuple[int, int]]()  # the latest time of a topic, and the one before
    for row in rows:
        if row is None:
            yield epoch, Found(at_us, DAMAGE, {})
        if row is None or abs(row.time_us - overview.middle_us) >= LONGEST_LOG_US:
            continue
        at_us = row.time_us
        last_us, before_us = latest_us.setdefault(row.topic, (at_us, at_us - 1))
        held = behind.get(row.topic, [])
        back_us = last_us - row.time_us if row.time_us <= before_us else 0
        if back_us > LEAST_BACK_US and (not held or row.time_us > held[-1].time_us):
            behind[row.topic] = [*held, row]
            if len(held) + 1 < (ROWS_FAR_BACK if back_us > REORDERED_US else ROWS_BACK):
                continue
            epoch, latest_us = epoch + 1, {row.topic: (row.time_us, held[-1].time_us)}
            yield from ((epoch, each) for topic in behind.values() for each in topic)
            behind.clear()
            continue
        yield from ((epoch, each) for each in behind.pop(row.topic, ()))
        if row.time_us > last_us:
            latest_us[row.topic] = row.time_us, last_us
        yield epoch, row
    yield from ((epoch, each) for topic in behind.values() for each in topic)


def _in_byte(value: float | None, default: int) -> int:
    return int(value) if value is not None and 0 < value <= 255 else default
