"""Every sample of a replay as a row of a table: CSV for spreadsheets.

``time_s`` is on the vehicle's continuous clock, 0 at the first IMU sample, ``time_unix_s`` by the
log's own stamps. Nothing depends on the computer's clock, so a log replayed twice gives the same
bytes.
"""

import csv
from collections.abc import Iterator
from math import degrees
from pathlib import Path

from drivers.output_file import output_path
from estimator.errors import InputError
from estimator.geometry.frames import euler_rad
from estimator.types import Attitude, Quaternion
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.log_clock import unix_times_us
from fuzzbee.replays.trace import VehicleTrace

Value = float | str | None

LARGE = 1e8  # a date in seconds, to the microsecond

ATTITUDE_COLUMNS = (
    *("time_s", "time_unix_s"),
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


def rows(trace: VehicleTrace, compared: Comparison) -> Iterator[tuple[Value, ...]]:
    """One row a sample, in the order of :data:`COLUMNS`; None where there is no reference."""
    start_us = trace.attitudes[0].time_us
    reference = zip(
        compared.known.tolist(),
        compared.truth.tolist(),
        compared.errors_rad.tolist(),
        strict=True,
    )
    unix_us = unix_times_us(trace)
    dates: list[float | None] = [None] * len(trace.attitudes)
    if unix_us is not None:
        dates = (1e-6 * unix_us).tolist()
    for attitude, date_s, (known, truth, errors) in zip(
        trace.attitudes, dates, reference, strict=True
    ):
        beside: tuple[Value, ...] = (None,) * len(REFERENCE_COLUMNS)
        if known:
            q = (truth[0], truth[1], truth[2], truth[3])
            beside = (*q, *_euler_deg(q), *map(degrees, errors))
        time_s = 1e-6 * (attitude.time_us - start_us)
        yield (time_s, date_s, *_attitude_values(attitude), *beside)


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


def _attitude_values(attitude: Attitude) -> tuple[Value, ...]:
    return (
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
    if isinstance(value, str):
        return value
    return f"{value:.6f}" if value > LARGE else f"{value:.9g}"
