"""A trace beside its reference; scores, exports and plots are made from it."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.logs.reference_track import row
from drivers.logs.spill_file import SpillFile, blocks
from estimator.arrays import Bools, Floats
from estimator.errors import InputError
from estimator.types import IDENTITY
from fuzzbee.replays.score import errors_against
from fuzzbee.replays.trace import VehicleTrace

# What they are called for a person; the truth, a simulator's or a table's own, goes first
REFERENCES = {"sim": "truth", "autopilot": "autopilot"}


class Beside(NamedTuple):
    """Reference attitudes (N, 4), where they are known, errors (N, 3: total, heading, inclination).

    Radians; the first and the last mean something only where ``known``.
    """

    truth: Floats
    known: Bools
    errors_rad: Floats


class Comparison:
    """A trace beside its reference, sample by sample; ``source`` is None without any reference."""

    def __init__(self, source: str | None, beside: Iterable[Beside] = ()) -> None:
        self.source = source
        self._rows = SpillFile("d", 8)
        for each in beside:
            self._rows.add(np.column_stack(each))

    def part(self, rows: slice = slice(None)) -> Beside:
        """Some samples."""
        found = self._rows.rows(rows)
        return Beside(found[:, :4], found[:, 4] > 0.0, found[:, 5:])

    @property
    def truth(self) -> Floats:
        """Reference attitudes (N, 4)."""
        return self.part().truth

    @property
    def known(self) -> Bools:
        """Where they are known (N,)."""
        return self.part().known

    @property
    def errors_rad(self) -> Floats:
        """Errors (N, 3)."""
        return self.part().errors_rad


def compare(path: Path, trace: VehicleTrace, wanted: str | None) -> Comparison:
    """The trace against the wanted reference, or the best there is.

    Raises:
        InputError: the wanted reference is not in the log.
    """
    source = _choose_reference(path, trace, wanted)
    parts = blocks(len(trace.attitudes))
    return Comparison(source, (_beside(trace, source, rows) for rows in parts))


def _beside(trace: VehicleTrace, source: str | None, rows: slice) -> Beside:
    if source is None:
        n = rows.stop - rows.start
        return Beside(np.broadcast_to(IDENTITY, (n, 4)), np.zeros(n, bool), np.zeros((n, 3)))
    truth, known = reference_attitudes(trace, source, rows)
    return Beside(truth, known, errors_against(trace.column("q_ned_frd", rows), truth))


def reference_attitudes(
    trace: VehicleTrace, source: str, rows: slice = slice(None)
) -> tuple[Floats, Bools]:
    """``q_ned_frd`` (N, 4) of the IMU at some samples, and where it is known.

    The autopilot reports on the vehicle, or what its pilot is to see; the simulator's truth is the
    IMU's own.
    """
    attitudes, known = trace.references[source].at(trace.attitudes.times_of(rows))
    message = trace.references[source].message
    if source == "autopilot" and message is not None and not trace.view.is_imus:
        ours = trace.column("q_ned_frd", rows)
        for k in np.flatnonzero(known).tolist():
            found = trace.view.of_imu(message, row(attitudes, k), row(ours, k))
            known[k] = found is not None
            attitudes[k] = attitudes[k] if found is None else found
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
