"""Every sample of a replay in a file: CSV for spreadsheets, MCAP for viewers.

Times are on the vehicle's continuous clock, t = 0 at the first IMU sample. Nothing
depends on the computer's own clock, so a log replayed twice gives the same bytes.
"""

import csv
import json
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from math import degrees
from pathlib import Path
from typing import Any

from drivers.output_file import output_path
from estimator.errors import InputError
from estimator.geometry.frames import euler_rad
from estimator.types import Attitude, Quaternion
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.trace import VehicleTrace

Value = float | str | None

ATTITUDE_COLUMNS = (
    "time_s",
    *("q_w", "q_x", "q_y", "q_z"),
    *("roll_deg", "pitch_deg", "yaw_deg"),
    *("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"),
    *("bias_x_rad_s", "bias_y_rad_s", "bias_z_rad_s"),
    *("error", "error_rate_1_s", "gain"),
    *("confidence_gravity", "confidence_magnetic"),
    *("sigma_inclination_deg", "sigma_heading_deg"),
    "heading_reference",
)
REFERENCE_COLUMNS = (
    *("reference_q_w", "reference_q_x", "reference_q_y", "reference_q_z"),
    *("reference_roll_deg", "reference_pitch_deg", "reference_yaw_deg"),
    *("error_total_deg", "error_heading_deg", "error_inclination_deg"),
)
COLUMNS = ATTITUDE_COLUMNS + REFERENCE_COLUMNS
TOPICS = (("/attitude", ATTITUDE_COLUMNS), ("/reference", ("time_s", *REFERENCE_COLUMNS)))


def rows(trace: VehicleTrace, compared: Comparison) -> Iterator[tuple[Value, ...]]:
    """One row a sample, in the order of :data:`COLUMNS`; None where there is no reference."""
    start_us = trace.attitudes[0].time_us
    reference = zip(
        compared.known.tolist(),
        compared.truth.tolist(),
        compared.errors_rad.tolist(),
        strict=True,
    )
    for attitude, (known, truth, errors) in zip(trace.attitudes, reference, strict=True):
        beside: tuple[Value, ...] = (None,) * len(REFERENCE_COLUMNS)
        if known:
            q = (truth[0], truth[1], truth[2], truth[3])
            beside = (*q, *_euler_deg(q), *map(degrees, errors))
        yield (*_attitude_values(attitude, start_us), *beside)


def write_csv(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """All samples as CSV with a heading; nine significant digits, empty where unknown.

    Raises:
        InputError: the file cannot be written.
    """
    try:
        with output_path(path).open("w", encoding="utf-8", newline="") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(COLUMNS)
            out.writerows(map(_text, row) for row in rows(trace, compared))
    except OSError as error:
        raise InputError(f"--csv {path}: {error.strerror}") from None


def require_mcap(path: Path) -> None:
    """Refuse, before the replay, what cannot be written after it.

    Raises:
        InputError: the library is missing.
    """
    if find_spec("mcap") is None:
        raise InputError(f"--mcap {path}: needs mcap (the extra 'mcap')")


def write_mcap(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """The topics /attitude and /reference as JSON messages with their schema.

    Raises:
        InputError: the file cannot be written.
    """
    try:
        with output_path(path).open("wb") as file:
            _write_messages(file, trace, compared)
    except OSError as error:
        raise InputError(f"--mcap {path}: {error.strerror}") from None


def _write_messages(file: Any, trace: VehicleTrace, compared: Comparison) -> None:
    from mcap.writer import CompressionType, Writer

    writer = Writer(file, compression=CompressionType.NONE)
    writer.start(profile="", library="fuzzbee")
    channels = [_channel(writer, topic, columns) for topic, columns in TOPICS]
    start_us = trace.attitudes[0].time_us
    first = len(ATTITUDE_COLUMNS)
    for number, row in enumerate(rows(trace, compared)):
        time_ns = 1000 * (trace.attitudes[number].time_us - start_us)
        parts = (row[:first], (row[0], *row[first:]))
        for channel, (_, columns), values in zip(channels, TOPICS, parts, strict=True):
            if values[-1] is None:
                continue  # no reference at this sample
            data = json.dumps(dict(zip(columns, values, strict=True))).encode()
            writer.add_message(channel, time_ns, data, time_ns, number)
    finish: Any = writer.finish  # untyped in the library
    finish()


def _channel(writer: Any, topic: str, columns: Sequence[str]) -> int:
    kinds = {name: {"type": "number"} for name in columns}
    if "heading_reference" in kinds:
        kinds["heading_reference"] = {"type": "string"}
    schema = json.dumps({"type": "object", "properties": kinds}).encode()
    number = writer.register_schema(f"fuzzbee{topic.replace('/', '.')}", "jsonschema", schema)
    channel: int = writer.register_channel(topic, "json", number)
    return channel


def _attitude_values(attitude: Attitude, start_us: int) -> tuple[Value, ...]:
    return (
        1e-6 * (attitude.time_us - start_us),
        *attitude.q_ned_frd,
        *_euler_deg(attitude.q_ned_frd),
        *attitude.rate_rad_s,
        *attitude.gyro_bias_rad_s,
        attitude.error,
        attitude.error_rate_1_s,
        attitude.gain,
        attitude.confidence_gravity,
        attitude.confidence_magnetic,
        degrees(attitude.sigma_inclination_rad),
        degrees(attitude.sigma_heading_rad),
        attitude.heading_reference,
    )


def _euler_deg(q: Quaternion) -> tuple[float, float, float]:
    roll, pitch, yaw = euler_rad(q)
    return (degrees(roll), degrees(pitch), degrees(yaw))


def _text(value: Value) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.9g}"
