"""Bags of ROS 1 and 2 (a folder, .mcap, .db3, .bag) with readings of ``sensor_msgs``.

Imu, MagneticField and NavSatFix, by REP 103 and 145: SI units and tesla, axes forward, left, up,
orientations from East-North-Up. Of several IMUs one is read that shows rates and forces: raw before
filtered, then the one with most messages; a filtered one beside it has the attitude to compare
with.
"""

import hashlib
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

from drivers.events import Event, Malformed
from drivers.logs.bag_libraries import BoundedPath, McapChannels, bound_libraries, from_json
from drivers.logs.log_file import LATEST_US, LogFile
from drivers.logs.logged_vehicle import ONE_VEHICLE, RECEIVER, LoggedVehicle
from drivers.samples.navigation import Fix, unit_or_none
from estimator.errors import InputError, missing_extra
from estimator.geometry.frames import flu_from_frd
from estimator.types import IDENTITY, Vec3

SUFFIXES = (".mcap", ".db3", ".bag")
IMU, FIELD, FIX = (f"sensor_msgs/msg/{name}" for name in ("Imu", "MagneticField", "NavSatFix"))
TESLA = 1e4  # gauss
MOST_TOPICS = 8  # in a line
MOST_METADATA = 1 << 21  # bytes, which take 20 s; some 8,000 files have as much
PACE_MESSAGES = 100  # that show whether the recorder's times are those of arrival
MOST_OFF_PACE = 2.0

Decode = Callable[[Any, bytes], Any]

_log = logging.getLogger(__name__)


class Bag(LogFile):
    """A bag as events in the order of its recording, one message at a time.

    Raises:
        InputError: from the iteration, if it cannot be read at all.
    """

    def __iter__(self) -> Iterator[Event]:
        reader, decode = self._opened()
        try:
            imus = [each for each in reader.connections if each.msgtype == IMU]
            halves = {each.topic for each in imus if not _is_whole(reader, decode, each)}
            topics = _Topics(reader.connections, halves)
            if topics.connections:
                yield from _events(reader, decode, topics)
        finally:
            reader.close()

    def sha256(self) -> str:
        """The SHA-256 of the file, or of the folder's files one after the other."""
        if not self.path.is_dir():
            return super().sha256()
        digests = (bytes.fromhex(Bag(each).sha256()) for each in self._files())
        return hashlib.sha256(b"".join(digests)).hexdigest()

    def _files(self) -> list[Path]:
        """The folder's files; it may hold other folders, but nothing else."""
        try:
            found = sorted(each for each in self.path.iterdir() if not each.is_dir())
        except OSError as error:
            raise InputError(f"{self.path}: cannot be read: {error.strerror}") from None
        for each in found:
            if not each.is_file():
                raise InputError(f"{each}: not a file but a pipe, a device or a lost link")
        if (self.path / "metadata.yaml").stat().st_size > MOST_METADATA:
            raise InputError(f"{self.path}: its metadata.yaml is larger than any")
        return found

    def advice(self, system_id: int | None = None) -> str | None:
        """What topics there are, and how they are written if that cannot be read."""
        if system_id not in (None, ONE_VEHICLE.system_id):
            return None
        reader, _ = self._opened()
        shown = sorted({f"{each.topic} ({each.msgtype})" for each in reader.connections})
        reader.close()
        if any(IMU in each for each in shown):
            return None
        return f"no sensor_msgs/Imu; it has {', '.join(shown[:MOST_TOPICS]) or 'no topic'}"

    def _opened(self) -> tuple[Any, Decode]:
        """A reader, and what makes a message of a connection's bytes."""
        try:
            from rosbags import rosbag1, rosbag2
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise missing_extra(f"{self.path}", "bags") from None
        bound_libraries()
        if self.path.is_dir():
            self._files()
        ros1 = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
        ros2 = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
        kinds: dict[str, Any] = {".bag": rosbag1.Reader, ".mcap": McapChannels}
        kind = kinds.get(self.path.suffix.lower() if self.path.is_file() else "", rosbag2.Reader)
        try:
            reader = kind(BoundedPath(self.path))
            reader.open()
        except Exception as error:  # whatever a damaged file makes of the library
            raise InputError(f"{self.path}: cannot read this bag: {_words(error)}") from error

        usual = "ros1" if kind is rosbag1.Reader else "cdr"
        decoders = {"json": from_json, "ros1": ros1, "cdr": ros2}

        def decode(connection: Any, data: bytes) -> Any:
            encoding = getattr(connection, "encoding", usual)
            return decoders[encoding](data, connection.msgtype)

        return reader, decode


def _is_whole(reader: Any, decode: Decode, connection: Any) -> bool:
    """Whether an IMU's first message shows rates and forces; a camera may send them apart.

    The covariance of what is unknown begins with -1 (REP 145).
    """
    with suppress(Exception):  # whatever a damaged file makes of the library
        message = decode(*next((c, data) for c, _, data in reader.messages([connection])))
        absent = [
            getattr(message, f"{name}_covariance", [0.0])[0] == -1.0
            for name in ("angular_velocity", "linear_acceleration")
        ]
        vectors = message.angular_velocity, message.linear_acceleration
        return all(any(_vector(each)) for each in vectors) and not any(absent)
    return False


class _Topics:
    """Which topics are read; those of ``halves`` only where there is no other IMU."""

    def __init__(self, connections: Sequence[Any], halves: set[str]) -> None:
        whole = [each for each in connections if each.topic not in halves]
        self.imu = _chosen(whole, IMU, "", raw=True) or _chosen(connections, IMU, "", raw=True)
        self.attitude = _chosen(connections, IMU, self.imu, raw=False)
        field, fix = (_chosen(connections, kind, self.imu) for kind in (FIELD, FIX))
        wanted = {(IMU, self.imu), (IMU, self.attitude), (FIELD, field), (FIX, fix)}
        self.connections = [c for c in connections if (c.msgtype, c.topic) in wanted]


def _has_arrivals(reader: Any, decode: Decode, topics: _Topics) -> bool:
    """Whether the recorder's times are those of arrival, and show a gap from a leap of the clock.

    They keep the stamps' pace then, but not to the nanosecond: what converts a recording writes
    the stamps once more, or its own time.
    """
    imus = [each for each in topics.connections if each.topic == topics.imu]
    with suppress(Exception):  # whatever a damaged file makes of the library
        read = islice(reader.messages(imus), PACE_MESSAGES)
        times = [(recorded_ns, _stamp_ns(decode(c, data))) for c, recorded_ns, data in read]
        (first_ns, begin_ns), (last_ns, end_ns) = times[0], times[-1]
        stamped_ns, recorded_ns = end_ns - begin_ns, last_ns - first_ns
        keeps_pace = stamped_ns < MOST_OFF_PACE * recorded_ns < MOST_OFF_PACE**2 * stamped_ns
        return keeps_pace and len({recorded - stamp for recorded, stamp in times}) > 1
    return False


def _stamp_ns(message: Any) -> int:
    return int(10**9 * message.header.stamp.sec + message.header.stamp.nanosec)


def _events(reader: Any, decode: Decode, topics: _Topics) -> Iterator[Event]:
    """All of the bag; a damaged message is counted, and where the bag is damaged it ends."""
    vehicle = None
    has_arrivals = _has_arrivals(reader, decode, topics)
    try:
        for connection, recorded_ns, data in reader.messages(topics.connections):
            try:
                message = decode(connection, data)
                time_us = (_stamp_ns(message) or recorded_ns) // 1000
                if abs(time_us) >= LATEST_US:
                    raise ValueError(f"stamped {time_us} us")  # noqa: TRY301 - as the library would
                if vehicle is None:
                    vehicle = LoggedVehicle(
                        begin_us=time_us, checks_axes=True, has_arrivals=has_arrivals
                    )
                vehicle.at(time_us, arrival_us=recorded_ns // 1000 if has_arrivals else None)
                events = _message_events(vehicle, topics, connection, message)
            except Exception:  # noqa: BLE001 - as below
                events = [Malformed(0, 1)]
            yield from events
    except Exception as error:  # noqa: BLE001 - whatever a damaged file makes of the library
        _log.warning("%s: read no further: %s", reader.path, _words(error))
        yield Malformed(0, 1)
    if vehicle is not None:
        yield from vehicle.intake.end()


def _words(error: Exception) -> str:
    """What is wrong; of some errors only the name shows it."""
    return str(error) or type(error).__name__


def _message_events(
    vehicle: LoggedVehicle, topics: _Topics, connection: Any, message: Any
) -> list[Event]:
    if connection.msgtype == FIELD:
        x, y, z = flu_from_frd(_vector(message.magnetic_field))
        return vehicle.put_mag((TESLA * x, TESLA * y, TESLA * z))
    if connection.msgtype == FIX:
        if message.status.status < 0:
            return []
        position = (message.latitude, message.longitude, message.altitude)
        return vehicle.fix(RECEIVER, Fix(position=position))
    topic, events = connection.topic, list[Event]()
    if topic == topics.imu:
        gyr = flu_from_frd(_vector(message.angular_velocity))
        acc = flu_from_frd(_vector(message.linear_acceleration))
        events += vehicle.imu(topic, gyr, acc)
    q = message.orientation
    q_wxyz = (q.w, q.x, q.y, q.z)
    is_reported = unit_or_none(q_wxyz) != IDENTITY and message.orientation_covariance[0] != -1.0
    if topic == topics.attitude and is_reported:
        name = f"{topic}.orientation"
        events += vehicle.attitude(name, "autopilot", q_wxyz, is_enu_flu=True)
    return events


def _chosen(connections: Sequence[Any], kind: str, beside: str, *, raw: bool | None = None) -> str:
    """The topic of that kind to read: raw or not, in the same namespace, with most messages."""

    def rank(connection: Any) -> tuple[Any, ...]:
        topic = connection.topic
        is_other = raw is not None and ("raw" in topic) != raw
        is_elsewhere = topic.rpartition("/")[0] != beside.rpartition("/")[0]
        return is_other, is_elsewhere, -connection.msgcount, topic

    found = sorted((c for c in connections if c.msgtype == kind), key=rank)
    return found[0].topic if found else ""


def _vector(vector: Any) -> Vec3:
    return (vector.x, vector.y, vector.z)
