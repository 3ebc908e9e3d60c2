"""Every sample of a replay as MCAP messages: tables to plot, and types that Foxglove draws.

Messages are stamped with the time that the log was written at, if it has dates; otherwise from
its first sample on. ``foxglove.FrameTransform``:
https://docs.foxglove.dev/docs/sdk/schemas/frame-transform. ``sensor_msgs/msg/Imu`` comes with the
types that it is made of, as https://mcap.dev/spec/registry#ros2msg wants them.
"""

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from math import isnan
from pathlib import Path
from typing import Any

from drivers.logs.table import blocks
from drivers.output_file import written_for
from fuzzbee.attitudes import enu_flu
from fuzzbee.replays.exports import ATTITUDE_COLUMNS, REFERENCE_COLUMNS, columns, stamps_us
from fuzzbee.replays.trace import VehicleTrace
from service.sinks.ros_messages import imu_message

# East, north, up; the vehicle's body; and the same body as the reference has it.
WORLD, BODY, REFERENCE_BODY = "map", "base_link", "reference"
TABLES = {
    "/attitude": ATTITUDE_COLUMNS,
    "/reference": ("time_s", "time_unix_s", *REFERENCE_COLUMNS),
}
FRAME_TRANSFORM = "foxglove.FrameTransform"
IMU = "sensor_msgs/msg/Imu"
IMU_DEFINITION = f"\n{'=' * 80}\nMSG: ".join(
    (
        """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance""",
        "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
        "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z",
    )
)

Message = tuple[str, int, bytes]  # topic, time (us), data


def write_mcap(path: Path, trace: VehicleTrace) -> None:
    """The topics /attitude, /reference, /tf and /imu."""
    from mcap.writer import CompressionType, Writer

    with written_for("--mcap", path) as fresh, fresh.open("wb") as file:
        writer: Any = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="fuzzbee")
        channels = {}
        for topic, kind, encoding, schema_encoding, schema in _topics():
            number = writer.register_schema(kind, schema_encoding, schema)
            channels[topic] = writer.register_channel(topic, encoding, number)
        counts: Counter[str] = Counter()
        for topic, time_us, data in _messages(trace):
            time_ns = 1000 * time_us
            writer.add_message(channels[topic], time_ns, data, time_ns, counts[topic])
            counts[topic] += 1
        writer.finish()


def _topics() -> Iterator[tuple[str, str, str, str, bytes]]:
    """Name, type, encoding of the messages and of the schema, and the schema."""
    number, whole, text = ({"type": kind} for kind in ("number", "integer", "string"))
    for topic, names in TABLES.items():
        kinds = {name: text if name == "heading_reference" else number for name in names}
        schema = json.dumps(_object(kinds)).encode()
        yield topic, f"fuzzbee{topic.replace('/', '.')}", "json", "jsonschema", schema
    parts = {
        "timestamp": _object({"sec": whole, "nsec": whole}, "time"),
        "parent_frame_id": text,
        "child_frame_id": text,
        "translation": _object(dict.fromkeys("xyz", number), "foxglove.Vector3"),
        "rotation": _object(dict.fromkeys("xyzw", number), "foxglove.Quaternion"),
    }
    schema = json.dumps(_object(parts, FRAME_TRANSFORM)).encode()
    yield "/tf", FRAME_TRANSFORM, "json", "jsonschema", schema
    yield "/imu", IMU, "cdr", "ros2msg", IMU_DEFINITION.encode()


def _object(properties: dict[str, Any], title: str | None = None) -> dict[str, Any]:
    named = {} if title is None else {"title": title}
    return {"type": "object", **named, "properties": properties}


def _messages(trace: VehicleTrace) -> Iterator[Message]:
    """Of each sample the rows that a CSV has, the attitude in space, and an IMU's message."""
    stamps = stamps_us(trace)
    for rows, part in zip(blocks(len(trace)), columns(trace), strict=True):
        times_us = stamps[rows].tolist()
        poses = (enu_flu(trace[name][rows]) for name in ("q_ned_frd", "reference_q_ned_frd"))
        own = zip(*(column.tolist() for column in part.values()), strict=True)
        each = zip(times_us, own, *poses, trace.published(rows, times_us), strict=True)
        for time_us, values, pose, beside, (record, sample) in each:
            row = dict(zip(part, values, strict=True))
            for topic, names in TABLES.items():
                known = {name: row[name] for name in names if row[name] == row[name]}
                if names[-1] in known:  # there is a reference at this sample
                    yield topic, time_us, json.dumps(known).encode()
            yield "/tf", time_us, _transform(time_us, BODY, pose.tolist())
            if not isnan(beside[0]):
                yield "/tf", time_us, _transform(time_us, REFERENCE_BODY, beside.tolist())
            if record is not None:
                yield "/imu", time_us, imu_message(record, sample.acc_m_s2, BODY)


def _transform(time_us: int, child: str, q_enu_flu: Iterable[float]) -> bytes:
    seconds, micros = divmod(time_us, 1_000_000)
    message = {
        "timestamp": {"sec": seconds, "nsec": 1000 * micros},
        "parent_frame_id": WORLD,
        "child_frame_id": child,
        "translation": dict.fromkeys("xyz", 0.0),
        "rotation": dict(zip("wxyz", q_enu_flu, strict=True)),
    }
    return json.dumps(message).encode()
