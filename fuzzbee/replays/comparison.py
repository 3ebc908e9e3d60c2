"""A trace beside its reference; scores, exports and plots are made from it."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.geometry.quaternion import multiply
from estimator.types import IDENTITY
from fuzzbee.replays.score import errors_against
from fuzzbee.replays.trace import VehicleTrace

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

BLOCK = 20_000
REFERENCES = ("sim", "autopilot")  # the truth goes first


class Comparison(NamedTuple):
    """Reference attitudes (N, 4) and errors (N, 3: total, heading, inclination, rad).

    Both mean something only where ``known``; ``source`` is None without any reference.
    """

    source: str | None
    truth: Floats
    known: Bools
    errors_rad: Floats


def compare(path: Path, trace: VehicleTrace, wanted: str | None) -> Comparison:
    """The trace against the wanted reference, or the best there is.

    Raises:
        InputError: the wanted reference is not in the log.
    """
    source = _choose_reference(path, trace, wanted)
    n = len(trace.attitudes)
    if source is None:
        return Comparison(
            None, np.broadcast_to(IDENTITY, (n, 4)), np.zeros(n, bool), np.zeros((n, 3))
        )
    truth, known = reference_attitudes(trace, source)
    return Comparison(source, truth, known, errors_against(trace.estimates, truth))


def reference_attitudes(trace: VehicleTrace, source: str) -> tuple[Floats, Bools]:
    """``q_ned_frd`` (N, 4) of the IMU at its samples, and where it is known.

    The autopilot reports on the vehicle, in which the IMU is mounted with a
    trim; the simulator's truth is the IMU's own.
    """
    attitudes, known = trace.references[source].at(trace.times_us)
    if source == "autopilot" and trace.trim != IDENTITY:
        for begin in range(0, len(attitudes), BLOCK):  # as lists an hour's take too much room
            part = attitudes[begin : begin + BLOCK]
            part[:] = [multiply((w, x, y, z), trace.trim) for w, x, y, z in part.tolist()]
    return attitudes, known


def _choose_reference(path: Path, trace: VehicleTrace, wanted: str | None) -> str | None:
    available = [name for name in REFERENCES if trace.references[name].message is not None]
    if wanted is None:
        return available[0] if available else None
    if wanted not in available:
        raise InputError(
            f"{path}: no reference '{wanted}' for vehicle {trace.address.system_id}"
            f" (there is: {', '.join(available) or 'none'})"
        )
    return wanted
