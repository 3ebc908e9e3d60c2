"""Every sample of a replay as a row of a table: CSV, Parquet, trajectories for evo; the viewer.

``time_s`` is on the vehicle's continuous clock, 0 at the log's first IMU sample, ``time_unix_s`` by
the log's own stamps. Nothing depends on the computer's clock, so a log replayed twice gives the
same bytes. A file that cannot be written is an InputError, here as in every other export.
"""

import csv
from collections.abc import Iterable, Iterator
from contextlib import suppress
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drivers.logs.table import blocks
from drivers.output_file import written_for
from estimator.arrays import Floats, Times
from estimator.live.rows import NORTHS
from fuzzbee.attitudes import enu_flu, euler_curves_deg
from fuzzbee.replays.trace import VehicleTrace
from service.publishing import HostClock
from service.records import Output, Peer, Published

if TYPE_CHECKING:
    from fuzzbee.viewer.viewer import ViewerSink

Columns = dict[str, NDArray[Any]]  # (N,) each

LARGE = 1e8  # a date in seconds, to the microsecond
# Stamps before September 2001 count from the vehicle's start: it knew no date.
EARLIEST_UNIX_US = 10**15
# ROS has 31 bits for the seconds, until 2038: a later date is a garbled stamp.
LATEST_UNIX_US = 10**6 << 31

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
SAME = (
    *("rate_rad_s", "gyro_bias_rad_s", "error", "error_rate_1_s", "gain"),
    *("confidence_gravity", "confidence_magnetic"),
)


def stamps_us(trace: VehicleTrace) -> Times:
    """Unix time (N,) of the samples, or the time since the first where that is not known."""
    unix_us = unix_times_us(trace)
    return trace["time_us"] - trace.zero_us if unix_us is None else unix_us


def unix_times_us(trace: VehicleTrace) -> Times | None:
    """Unix time (N,) of the samples; None if the log's stamps are no dates.

    A message is stamped when it arrives, now soon, now late: the vehicle's own clock is carried
    over as in the live service. Times never go back.
    """
    times_us, arrivals_us = trace["time_us"], trace["arrival_us"]
    if not len(arrivals_us) or arrivals_us[0] < EARLIEST_UNIX_US:
        return None
    clock, found = HostClock(), np.empty(len(arrivals_us), dtype=np.int64)
    for rows in blocks(len(found)):
        both = zip(times_us[rows].tolist(), arrivals_us[rows].tolist(), strict=True)
        for k, (time_us, arrival_us) in enumerate(both, rows.start):
            clock.observe(time_us, arrival_us)
            found[k] = round(time_us + clock.offset_us)
    return np.maximum.accumulate(found) if found.max() < LATEST_UNIX_US else None


def columns(trace: VehicleTrace) -> Iterator[Columns]:
    """The columns :data:`COLUMNS`, some rows at a time; NaN where something is not known."""
    unix_us, time_s = unix_times_us(trace), trace.time_s
    unix_s = np.full(len(trace), np.nan) if unix_us is None else 1e-6 * unix_us
    for rows in blocks(len(trace)):
        q, reference = trace["q_ned_frd"][rows], trace["reference_q_ned_frd"][rows]
        own = [time_s[rows], unix_s[rows], q, euler_curves_deg(q)]
        own += [trace[name][rows] for name in SAME]
        own += [np.degrees(trace[f"sigma_{of}_rad"][rows]) for of in ("inclination", "heading")]
        beside = (reference, euler_curves_deg(reference), np.degrees(trace["error_rad"][rows]))
        norths = np.array(NORTHS)[trace["heading_reference"][rows]]
        values = (*np.column_stack(own).T, norths, *np.column_stack(beside).T)
        yield dict(zip(COLUMNS, values, strict=True))


def write_csv(path: Path, trace: VehicleTrace) -> None:
    """The columns :data:`COLUMNS` of a trace as CSV."""
    write_columns(path, columns(trace))


def write_columns(path: Path, parts: Iterable[Columns]) -> None:
    """Columns as CSV with a heading; nine significant digits, empty where unknown."""
    with (
        written_for("--csv", path) as fresh,
        fresh.open("w", encoding="utf-8", newline="") as file,
    ):
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

    kinds = [(n, pa.string() if n == "heading_reference" else pa.float64()) for n in COLUMNS]
    with (
        written_for("--parquet", path) as fresh,
        fresh.open("wb") as file,
        ParquetWriter(file, pa.schema(kinds)) as writer,
    ):
        for part in columns(trace):
            arrays = {name: pa.array(part[name], kind, from_pandas=True) for name, kind in kinds}
            writer.write_table(pa.table(arrays))


def reference_path(path: Path) -> Path:
    """Where the reference goes."""
    return path.parent / f"{path.stem}.reference{path.suffix}"


def write_tum(path: Path, trace: VehicleTrace) -> None:
    """The estimate in ``path``, and in NAME.reference.SUFFIX the reference where it is known.

    A line a sample: time in s, place (zero: there is none), orientation x y z w of
    forward-left-up in East-North-Up (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
    """
    times_us, reference = stamps_us(trace), trace["reference_q_ned_frd"]
    known = ~np.isnan(reference[:, 0])
    _write_poses(path, times_us, trace["q_ned_frd"])
    if known.any():
        _write_poses(reference_path(path), times_us[known], reference[known])


def _write_poses(path: Path, times_us: Times, q_ned_frd: Floats) -> None:
    with written_for("--tum", path) as fresh, fresh.open("w", encoding="utf-8") as file:
        for rows in blocks(len(times_us)):
            q = enu_flu(q_ned_frd[rows])[:, [1, 2, 3, 0]]
            poses = np.column_stack([1e-6 * times_us[rows], np.zeros((len(q), 3)), q])
            np.savetxt(file, poses, "%.6f %d %d %d %.9f %.9f %.9f %.9f")


def show(viewer: "ViewerSink", trace: VehicleTrace) -> None:
    """Draw a trace in the viewer at the log's own times, with the attitudes by others beside it."""
    for output in _outputs(trace):
        if not viewer.is_wanted:  # a full disk, which is reported at the end
            break
        with suppress(ConnectionError):  # the viewer was closed: a file may still be wanted
            viewer.handle([output])
    viewer.finish()


def _outputs(trace: VehicleTrace) -> Iterator[Output]:
    """What the service would have published at the samples."""
    for rows in blocks(len(trace)):
        times_us, arrivals_us = trace["time_us"][rows], trace["arrival_us"][rows].tolist()
        peers = {name: track.at(times_us).tolist() for name, track in trace.references.items()}
        for k, (record, sample) in enumerate(trace.published(rows, arrivals_us)):
            if record is not None:
                for source, attitudes in peers.items():
                    w, x, y, z = attitudes[k]
                    if not isnan(w):
                        of: Any = source
                        yield Peer(trace.address, of, (w, x, y, z))
                yield Published(trace.address, record, sample)
