"""A trace beside its reference: columns of its table that scores, exports and plots read."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.logs.table import blocks
from estimator.arrays import Floats
from estimator.errors import InputError
from estimator.geometry.metrics import batch_angle_errors
from fuzzbee.replays.trace import VehicleTrace

# What they are called for a person; the truth, a simulator's or a table's own, goes first
REFERENCES = {"sim": "truth", "autopilot": "autopilot"}


def compare(path: Path, trace: VehicleTrace, wanted: str | None) -> None:
    """Put the wanted reference, or the best there is, beside the trace, whose ``reference`` it is.

    Columns: ``reference_q_ned_frd`` (N, 4) and ``error_rad`` (N, 3: total, heading, inclination),
    and beside a truth ``autopilot_q_ned_frd`` and ``autopilot_error_rad``. NaN where not known.
    """
    available = [name for name in REFERENCES if trace.references[name].message is not None]
    if wanted is not None and wanted not in available:
        raise InputError(
            f"{path}: no reference '{wanted}' for vehicle {trace.address.system_id}"
            f" (there is: {', '.join(available) or 'none'})"
        )
    trace.reference = wanted or next(iter(available), None)
    trace.table.put("reference_q_ned_frd", _attitudes(trace, trace.reference))
    _put_errors(trace, "error_rad", "q_ned_frd")
    if has_peer(trace):
        trace.table.put("autopilot_q_ned_frd", _attitudes(trace, "autopilot"))
        _put_errors(trace, "autopilot_error_rad", "autopilot_q_ned_frd")


def has_peer(trace: VehicleTrace) -> bool:
    """Whether the autopilot's own estimate stands beside a truth."""
    return trace.reference == "sim" and trace.references["autopilot"].message is not None


def _put_errors(trace: VehicleTrace, name: str, of: str) -> None:
    pairs = ((trace[of][k], trace["reference_q_ned_frd"][k]) for k in blocks(len(trace)))
    trace.table.put(name, (batch_angle_errors(*pair) for pair in pairs))


def _attitudes(trace: VehicleTrace, source: str | None) -> Iterator[Floats]:
    """``q_ned_frd`` (N, 4) of the IMU, in parts.

    The autopilot reports on the vehicle, or what its pilot is to see; the simulator's truth is the
    IMU's own.
    """
    for rows in blocks(len(trace)):
        if source is None:
            yield np.full((rows.stop - rows.start, 4), np.nan)
            continue
        track = trace.references[source]
        shown = track.at(trace["time_us"][rows])
        if source == "autopilot" and track.message is not None and not trace.view.is_imus:
            ours = trace["q_ned_frd"][rows]
            for k in np.flatnonzero(np.isfinite(shown[:, 0])).tolist():
                pair = tuple(shown[k].tolist()), tuple(ours[k].tolist())
                found = trace.view.of_imu(track.message, *pair)
                shown[k] = np.nan if found is None else found
        yield shown
