"""A replay as trajectories in the TUM format, for evo and others.

A line a sample: time in s, place (zero: there is none), orientation x y z w of forward-left-up in
East-North-Up (https://cvg.cit.tum.de/data/datasets/rgbd-dataset/file_formats).
"""

from collections.abc import Iterable
from pathlib import Path

from drivers.output_file import written_whole
from estimator.errors import InputError
from estimator.geometry.frames import enu_flu_from_ned_frd
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.log_clock import stamps_us
from fuzzbee.replays.trace import VehicleTrace


def write_tum(path: Path, trace: VehicleTrace, compared: Comparison) -> None:
    """The estimate in ``path``, and in NAME.reference.SUFFIX the reference where it is known.

    Raises:
        InputError: a file cannot be written.
    """
    times_us = stamps_us(trace)
    _write(path, zip(times_us.tolist(), trace.estimates.tolist(), strict=True))
    known = compared.known
    if known.any():
        reference = zip(times_us[known].tolist(), compared.truth[known].tolist(), strict=True)
        _write(path.with_suffix(f".reference{path.suffix}"), reference)


def _write(path: Path, poses: Iterable[tuple[int, list[float]]]) -> None:
    try:
        with written_whole(path) as fresh, fresh.open("w", encoding="utf-8") as file:
            for time_us, (w, x, y, z) in poses:
                a, b, c, d = enu_flu_from_ned_frd((w, x, y, z))
                file.write(f"{1e-6 * time_us:.6f} 0 0 0 {b:.9f} {c:.9f} {d:.9f} {a:.9f}\n")
    except OSError as error:
        raise InputError(f"--tum {path}: {error.strerror}") from None
