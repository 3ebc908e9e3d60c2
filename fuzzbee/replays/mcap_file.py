"""Every sample of a replay as MCAP messages: tables to plot, and types that Foxglove draws.

Messages are stamped with the time that the log was written at, if it has dates; otherwise from
its first sample on.
"""

import json
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from drivers.logs.spill_file import blocks
from drivers.output_file import written_for
from estimator.geometry.frames import enu_flu_from_ned_frd
from estimator.types import Quaternion
from fuzzbee.replays import mcap_schemas
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.exports import ATTITUDE_COLUMNS, REFERENCE_COLUMNS, rows
from fuzzbee.replays.log_clock import stamps_us
from fuzzbee.replays.trace import VehicleTrace
from service.records import attitude_record
from service.sinks.ros_messages import imu_message

# East, north, up; the vehicle's body; and the same body as the reference has it.
WORLD, BODY, REFERENCE_BODY = "map", "base_link", "reference"
NO_PLACE = {"x": 0.0, "y": 0.0, "z": 0.0}


class Topic(NamedTuple):
    """A topic with the type of its messages."""

    name: str
    type: str
    encoding: str
    schema_encoding: str
    schema: bytes


def _table(name: str, columns: tuple[str, ...]) -> Topic:
    kind = f"fuzzbee{name.replace('/', '.')}"
    return Topic(name, kind, "json", "jsonschema", mcap_schemas.table_schema(columns))


TABLES = (
    ("/attitude", ATTITUDE_COLUMNS),
    ("/reference", ("time_s", "time_unix_s", *REFERENCE_COLUMNS)),
)
TOPICS = (
    *(_table(name, columns) for name, columns in TABLES),
    Topic(
        "/tf",
        mcap_schemas.FRAME_TRANSFORM,
        "json",
        "jsonschema",
        mcap_schemas.frame_transform_schema(),
    ),
    Topic("/imu", mcap_schemas.IMU, "cdr", "ros2msg", mcap_schemas.IMU_DEFINITION.encode()),
)

Put = Callable[[str, int, bytes], None]


def write_mcap(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """The topics /attitude, /reference, /tf and /imu.

    Raises:
        InputError: the file cannot be written.
    """
    with written_for("--mcap", path) as fresh, fresh.open("wb") as file:
        _write_messages(file, trace, compared)


def _write_messages(file: Any, trace: VehicleTrace, compared: Comparison) -> None:
    from mcap.writer import CompressionType, Writer

    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start(profile="", library="fuzzbee")
    channels = {topic.name: _channel(writer, topic) for topic in TOPICS}
    counts = dict.fromkeys(channels, 0)

    def put(topic: str, time_us: int, data: bytes) -> None:
        time_ns = 1000 * time_us
        writer.add_message(channels[topic], time_ns, data, time_ns, counts[topic])
        counts[topic] += 1

    _put_tables(put, trace, compared)
    _put_poses(put, trace, compared)
    finish: Any = writer.finish  # untyped in the library
    finish()


def _channel(writer: Any, topic: Topic) -> int:
    number = writer.register_schema(topic.type, topic.schema_encoding, topic.schema)
    channel: int = writer.register_channel(topic.name, topic.encoding, number)
    return channel


def _put_tables(put: Put, trace: VehicleTrace, compared: Comparison) -> None:
    """The rows that a CSV has, without what is not known."""
    first = len(ATTITUDE_COLUMNS)
    for time_us, row in zip(map(int, stamps_us(trace)), rows(trace, compared), strict=True):
        parts = (row[:first], (*row[:2], *row[first:]))
        for (topic, columns), values in zip(TABLES, parts, strict=True):
            if values[-1] is None:
                continue  # no reference at this sample
            known = {k: v for k, v in zip(columns, values, strict=True) if v is not None}
            put(topic, time_us, json.dumps(known).encode())


def _put_poses(put: Put, trace: VehicleTrace, compared: Comparison) -> None:
    """The attitude in space and as an IMU's message, the reference beside it."""
    beside = chain.from_iterable(
        zip(*compared.part(rows)[:2], strict=True) for rows in blocks(len(trace.attitudes))
    )
    for k, (time_us, (truth, known)) in enumerate(
        zip(map(int, stamps_us(trace)), beside, strict=True)
    ):
        attitude = trace.attitudes[k]
        put("/tf", time_us, _transform(time_us, BODY, attitude.q_ned_frd))
        if known:
            w, x, y, z = truth.tolist()
            put("/tf", time_us, _transform(time_us, REFERENCE_BODY, (w, x, y, z)))
        record = attitude_record(
            attitude, time_unix_us=time_us, time_boot_us=attitude.time_us, sequence=k
        )
        if record is not None:
            put("/imu", time_us, imu_message(record, trace.samples[k].acc_m_s2, BODY))


def _transform(time_us: int, child: str, q_ned_frd: Quaternion) -> bytes:
    seconds, micros = divmod(time_us, 1_000_000)
    w, x, y, z = enu_flu_from_ned_frd(q_ned_frd)
    message = {
        "timestamp": {"sec": seconds, "nsec": 1000 * micros},
        "parent_frame_id": WORLD,
        "child_frame_id": child,
        "translation": NO_PLACE,
        "rotation": {"x": x, "y": y, "z": z, "w": w},
    }
    return json.dumps(message).encode()
