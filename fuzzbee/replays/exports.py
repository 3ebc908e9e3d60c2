"""Every sample of a replay as a row of a table: CSV for spreadsheets.

``time_s`` is on the vehicle's continuous clock, 0 at the log's first IMU sample, ``time_unix_s`` by
the log's own stamps. Nothing depends on the computer's clock, so a log replayed twice gives the
same bytes.
"""

import csv
from collections.abc import Iterable, Iterator, Sequence
from math import isnan
from pathlib import Path

import numpy as np

from drivers.logs.spill_file import blocks
from drivers.output_file import written_for
from fuzzbee.angle_curves import euler_curves_deg
from fuzzbee.attitudes import attitude_arrays
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
    unix_us = unix_times_us(trace)
    for part in blocks(len(trace.attitudes)):
        truth, known, errors_rad = compared.part(part)
        attitudes = attitude_arrays(trace.attitudes, trace.zero_us, part)
        columns = [
            attitudes.time_s,
            np.full(len(attitudes), np.nan) if unix_us is None else 1e-6 * unix_us[part],
            attitudes.q_ned_frd,
            attitudes.euler_deg,
            attitudes.rate_rad_s,
            attitudes.gyro_bias_rad_s,
            attitudes.error,
            trace.column("error_rate_1_s", part),
            attitudes.gain,
            attitudes.confidence_gravity,
            attitudes.confidence_magnetic,
            np.degrees(attitudes.sigma_inclination_rad),
            np.degrees(attitudes.sigma_heading_rad),
        ]
        beside = np.column_stack([truth, euler_curves_deg(truth), np.degrees(errors_rad)])
        beside[~known] = np.nan
        parts = (np.column_stack(columns), attitudes.heading_reference, beside)
        for own, north, reference in zip(*(each.tolist() for each in parts), strict=True):
            yield (*map(_known, own), north, *map(_known, reference))


def _known(value: float) -> float | None:
    return None if isnan(value) else value


def write_csv(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """All samples as CSV with a heading; nine significant digits, empty where unknown.

    Raises:
        InputError: the file cannot be written.
    """
    write_rows(path, COLUMNS, rows(trace, compared))


def write_rows(path: Path, columns: Sequence[str], values: Iterable[Iterable[Value]]) -> None:
    """A heading and rows as CSV.

    Raises:
        InputError: the file cannot be written.
    """
    with (
        written_for("--csv", path) as fresh,
        fresh.open("w", encoding="utf-8", newline="") as file,
    ):
        out = csv.writer(file, lineterminator="\n")
        out.writerow(columns)
        out.writerows(map(_text, row) for row in values)


def _text(value: Value) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    return f"{value:.6f}" if value > LARGE else f"{value:.9g}"
