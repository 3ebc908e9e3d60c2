"""A replay as trajectories in the TUM format, for evo and others.

A line a sample: time in s, place (zero: there is none), orientation x y z w of forward-left-up in
East-North-Up (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.logs.spill_file import blocks
from drivers.output_file import written_for
from estimator.geometry.frames import enu_flu_from_ned_frd
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.log_clock import stamps_us
from fuzzbee.replays.trace import VehicleTrace


def reference_path(path: Path) -> Path:
    """Where the reference goes."""
    return path.parent / f"{path.stem}.reference{path.suffix}"


def write_tum(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """The estimate in ``path``, and in NAME.reference.SUFFIX the reference where it is known.

    Raises:
        InputError: a file cannot be written.
    """
    times_us, parts = stamps_us(trace), list(blocks(len(trace.attitudes)))
    _write(path, ((times_us[rows], trace.column("q_ned_frd", rows)) for rows in parts))
    if any(compared.part(rows).known.any() for rows in parts):
        beside = ((times_us[rows], *compared.part(rows)[:2]) for rows in parts)
        reference = ((times[known], truth[known]) for times, truth, known in beside)
        _write(reference_path(path), reference)


def _write(path: Path, poses: Iterable[tuple[NDArray[np.int64], NDArray[np.float64]]]) -> None:
    with written_for("--tum", path) as fresh, fresh.open("w", encoding="utf-8") as file:
        for times_us, attitudes in poses:
            for time_us, q in zip(times_us.tolist(), attitudes.tolist(), strict=True):
                w, x, y, z = enu_flu_from_ned_frd(tuple(q))
                file.write(f"{1e-6 * time_us:.6f} 0 0 0 {x:.9f} {y:.9f} {z:.9f} {w:.9f}\n")
