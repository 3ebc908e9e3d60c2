"""Every sample of a replay as a row of a table: CSV, Parquet, MCAP, trajectories; the viewer.

``time_s`` is on the vehicle's continuous clock, 0 at the log's first IMU sample, ``time_unix_s`` by
the log's own stamps. Nothing depends on the computer's clock, so a log replayed twice gives the
same bytes. A file that cannot be written is an InputError.

MCAP: ``foxglove.FrameTransform`` as in https://docs.foxglove.dev/docs/sdk/schemas/frame-transform;
``sensor_msgs/msg/Imu`` comes with the types that it is made of, as
https://mcap.dev/spec/registry#ros2msg wants them.
"""

import csv
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import chain
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.logs.table import blocks
from drivers.output_file import written_for
from estimator.live.rows import NORTHS
from estimator.types import Attitude, Floats, ImuSample, Times
from fuzzbee.attitudes import enu_flu, euler_curves_deg
from fuzzbee.replays.trace import VehicleTrace
from service.publishing import attitude_record
from service.records import AttitudeRecord, Published
from service.sinks.ros_messages import imu_message

if TYPE_CHECKING:
    from fuzzbee.viewer.viewer import ViewerSink

Columns = dict[str, NDArray[Any]]  # (N,) each

LARGE = 1e8  # a date in seconds, to the microsecond
EARLIEST_UNIX_US = 10**15  # September 2001; stamps before that count from the vehicle's start
LATEST_UNIX_US = 10**6 << 31  # 2038, as ROS has 31 bits: a later date is a garbled stamp

ANGLES, ERRORS = ("roll", "pitch", "yaw"), ("total", "heading", "inclination")
AS_THEY_ARE = ("error", "error_rate_1_s", "gain", "confidence_gravity", "confidence_magnetic")
LAST_OF_ATTITUDE = "heading_reference"  # of the columns; those behind it are of the reference

# East, north, up; the vehicle's body; and the same body as the reference has it.
WORLD, BODY, REFERENCE_BODY = "map", "base_link", "reference"
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


def stamps_us(trace: VehicleTrace) -> tuple[Times, bool]:
    """Unix time (N,) of the samples, or since the first if the stamps are no dates; which it is."""
    found = trace["unix_us"]
    if trace["arrival_us"][0] >= EARLIEST_UNIX_US and found.max() < LATEST_UNIX_US:
        return np.maximum.accumulate(found), True  # never back
    return trace["time_us"] - trace.zero_us, False


def columns(trace: VehicleTrace) -> Iterator[Columns]:
    """The columns of every file, some rows at a time; NaN where something is not known."""
    (unix_us, are_dates), time_s = stamps_us(trace), trace.time_s
    unix_s = 1e-6 * unix_us if are_dates else np.full(len(trace), np.nan)
    for rows in blocks(len(trace)):
        q, reference = trace["q_ned_frd"][rows], trace["reference_q_ned_frd"][rows]
        yield {
            "time_s": time_s[rows],
            "time_unix_s": unix_s[rows],
            **vectors("q_{}", "wxyz", q),
            **vectors("{}_deg", ANGLES, euler_curves_deg(q)),
            **vectors("rate_{}_rad_s", "xyz", trace["rate_rad_s"][rows]),
            **vectors("bias_{}_rad_s", "xyz", trace["gyro_bias_rad_s"][rows]),
            **{name: trace[name][rows] for name in AS_THEY_ARE},
            "sigma_inclination_deg": np.degrees(trace["sigma_inclination_rad"][rows]),
            "sigma_heading_deg": np.degrees(trace["sigma_heading_rad"][rows]),
            LAST_OF_ATTITUDE: np.array(NORTHS)[trace["heading_reference"][rows]],
            **vectors("reference_q_{}", "wxyz", reference),
            **vectors("reference_{}_deg", ANGLES, euler_curves_deg(reference)),
            **vectors("error_{}_deg", ERRORS, np.degrees(trace["error_rad"][rows])),
        }


def vectors(name: str, parts: Iterable[str], values: Floats) -> Columns:
    """Vectors (N, K) as K columns; a part of each stands in its name."""
    return {name.format(part): each for part, each in zip(parts, values.T, strict=True)}


def write_csv(path: Path, trace: VehicleTrace) -> None:
    """A trace as CSV."""
    write_columns(path, columns(trace))


def write_columns(path: Path, parts: Iterable[Columns]) -> None:
    """Columns as CSV with a heading; nine significant digits, empty where unknown."""
    with written_for("--csv", path) as fresh, fresh.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        for number, part in enumerate(parts):
            if number == 0:
                out.writerow(part)
            texts = (map(_text, values.tolist()) for values in part.values())
            out.writerows(zip(*texts, strict=True))


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    if isnan(value):
        return ""
    return f"{value:.6f}" if value > LARGE else f"{value:.9g}"


def write_parquet(path: Path, trace: VehicleTrace) -> None:
    """The rows that a CSV has, for tables too large for a text; null where unknown."""
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    tables = (
        pa.table({name: pa.array(each, from_pandas=True) for name, each in part.items()})
        for part in columns(trace)
    )
    first = next(tables)
    with (
        written_for("--parquet", path) as fresh,
        fresh.open("wb") as file,
        ParquetWriter(file, first.schema) as writer,
    ):
        for table in chain([first], tables):
            writer.write_table(table)


def reference_path(path: Path) -> Path:
    """Where the reference goes."""
    return path.parent / f"{path.stem}.reference{path.suffix}"


def write_tum(path: Path, trace: VehicleTrace) -> None:
    """The estimate in ``path``, and in NAME.reference.SUFFIX the reference where it is known.

    A line a sample: time in s, place (zero: there is none), orientation x y z w of
    forward-left-up in East-North-Up (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
    """
    times_us, _ = stamps_us(trace)
    for file, name in ((path, "q_ned_frd"), (reference_path(path), "reference_q_ned_frd")):
        known = np.flatnonzero(~np.isnan(trace[name][:, 0]))
        if not len(known):
            continue
        with written_for("--tum", file) as fresh, fresh.open("w", encoding="utf-8") as out:
            for rows in (known[part] for part in blocks(len(known))):
                q = enu_flu(trace[name][rows])[:, [1, 2, 3, 0]]
                poses = np.column_stack([1e-6 * times_us[rows], np.zeros((len(q), 3)), q])
                np.savetxt(out, poses, "%.6f %d %d %d %.9f %.9f %.9f %.9f")


def write_mcap(path: Path, trace: VehicleTrace) -> None:
    """The topics /attitude, /reference, /tf and /imu."""
    from mcap.writer import CompressionType, Writer

    names, counts = [*next(columns(trace))], Counter[str]()
    behind = names.index(LAST_OF_ATTITUDE) + 1
    tables = {"/attitude": names[:behind], "/reference": [*names[:2], *names[behind:]]}
    with written_for("--mcap", path) as fresh, fresh.open("wb") as file:
        writer: Any = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="fuzzbee")
        channels = {
            topic: writer.register_channel(topic, encoding, writer.register_schema(*schema))
            for topic, encoding, *schema in _topics(tables)
        }
        for topic, time_us, data in _messages(trace, tables):
            time_ns = 1000 * time_us
            writer.add_message(channels[topic], time_ns, data, time_ns, counts[topic])
            counts[topic] += 1
        writer.finish()


def _topics(tables: dict[str, list[str]]) -> Iterator[tuple[str, str, str, str, bytes]]:
    """Name, encoding of the messages, and their type, its encoding and the type in that."""
    number, whole, text = ({"type": kind} for kind in ("number", "integer", "string"))
    frame = {
        "timestamp": _object({"sec": whole, "nsec": whole}, title="time"),
        "parent_frame_id": text,
        "child_frame_id": text,
        "translation": _object(dict.fromkeys("xyz", number), title="foxglove.Vector3"),
        "rotation": _object(dict.fromkeys("xyzw", number), title="foxglove.Quaternion"),
    }
    schemas = {"/tf": _object(frame, title="foxglove.FrameTransform")}
    for topic, names in tables.items():
        kinds = {name: text if name == LAST_OF_ATTITUDE else number for name in names}
        schemas[topic] = _object(kinds)
    for topic, schema in schemas.items():
        kind = schema.get("title", f"fuzzbee.{topic[1:]}")
        yield topic, "json", kind, "jsonschema", msgspec.json.encode(schema)
    yield "/imu", "cdr", "sensor_msgs/msg/Imu", "ros2msg", IMU_DEFINITION.encode()


def _object(properties: dict[str, Any], **named: str) -> dict[str, Any]:
    return {"type": "object", **named, "properties": properties}


def _messages(trace: VehicleTrace, tables: dict[str, list[str]]) -> Iterator[Message]:
    """Of each sample the rows that a CSV has, the attitude in space, and an IMU's message."""
    stamps, _ = stamps_us(trace)
    for rows, part in zip(blocks(len(trace)), columns(trace), strict=True):
        times_us = stamps[rows].tolist()
        poses = (enu_flu(trace[name][rows]) for name in ("q_ned_frd", "reference_q_ned_frd"))
        own = zip(*(column.tolist() for column in part.values()), strict=True)
        each = zip(times_us, own, *poses, published(trace, rows, times_us), strict=True)
        for time_us, values, pose, beside, (record, sample) in each:
            row = dict(zip(part, values, strict=True))
            for topic, names in tables.items():
                known = {name: row[name] for name in names if row[name] == row[name]}
                if names[-1] in known:  # there is a reference at this sample
                    yield topic, time_us, msgspec.json.encode(known)
            seconds, micros = divmod(time_us, 1_000_000)
            frame: dict[str, Any] = {"timestamp": {"sec": seconds, "nsec": 1000 * micros}}
            for child, q in ((BODY, pose), (REFERENCE_BODY, beside)):
                if not isnan(q[0]):
                    frame |= {"parent_frame_id": WORLD, "child_frame_id": child}
                    frame["translation"] = dict.fromkeys("xyz", 0.0)
                    frame["rotation"] = dict(zip("wxyz", q.tolist(), strict=True))
                    yield "/tf", time_us, msgspec.json.encode(frame)
            if record is not None:
                yield "/imu", time_us, imu_message(record, sample.acc_m_s2, BODY)


def published(
    trace: VehicleTrace, rows: slice, stamps_us: Iterable[int]
) -> Iterator[tuple[AttitudeRecord | None, ImuSample]]:
    """What the service would have published with samples, whose Unix times are given."""
    attitudes, samples = (_values(trace, kind, rows) for kind in (Attitude, ImuSample))
    for attitude, sample, unix_us in zip(attitudes, samples, stamps_us, strict=True):
        times = {"time_unix_us": unix_us, "time_boot_us": sample.time_us}
        yield attitude_record(attitude, sequence=0, **times), sample


def _values(trace: VehicleTrace, kind: Any, rows: slice) -> Iterator[Any]:
    """The attitudes or the samples of some rows as the estimator has them."""
    columns = []
    for name in kind._fields:
        found = trace[name][rows]
        values = np.array(NORTHS)[found] if name == "heading_reference" else found
        columns.append(map(tuple, values.tolist()) if values.ndim > 1 else values.tolist())
    return map(kind, *columns)


def show(viewer: "ViewerSink", trace: VehicleTrace) -> None:
    """Draw what the service would have published at the log's times, and attitudes by others."""
    for rows in blocks(len(trace)):
        times_us, arrivals_us = trace["time_us"][rows], trace["arrival_us"][rows].tolist()
        peers = {name: track.at(times_us).tolist() for name, track in trace.references.items()}
        for k, (record, sample) in enumerate(published(trace, rows, arrivals_us)):
            if not viewer.is_wanted:  # on a full disk, reported at the end
                viewer.finish()
                return
            if record is not None:
                others: Any = ((name, tuple(attitudes[k])) for name, attitudes in peers.items())
                known = tuple(other for other in others if not isnan(other[1][0]))
                with suppress(ConnectionError):  # the viewer was closed: a file may still be wanted
                    viewer.handle([Published(trace.address, record, sample, peers=known)])
    viewer.finish()
