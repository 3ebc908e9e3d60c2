"""The samples of a replay that count for its figures, a part at a time."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.logs.spill_file import SpillFile, blocks
from estimator.arrays import Bools, Floats
from estimator.live.rows import NORTHS
from fuzzbee.replays.comparison import Comparison
from fuzzbee.replays.constant_turn import Turned
from fuzzbee.replays.motion import motion_mask
from fuzzbee.replays.trace import VehicleTrace

MICROSECOND = 1e-6


class Part(NamedTuple):
    """Samples of a trace that are scored (M,): attitudes (M, 4), errors (M, 3), rad."""

    rows: slice  # that they are among
    counted: Bools  # which of those they are
    estimates: Floats
    truth: Floats
    errors_rad: Floats
    sigma_inclination_rad: Floats
    sigma_heading_rad: Floats
    norths: NDArray[np.uint8]
    told: Bools  # whether there was a heading
    moved: Bools


class Scored:
    """The samples to score, in parts: those of a long log do not fit into memory together."""

    def __init__(self, trace: VehicleTrace, compared: Comparison, skip_s: float) -> None:
        self._trace, self._compared = trace, compared
        self._begin_us, self._skip_us = trace.attitudes[0].time_us, skip_s / MICROSECOND
        self._moved = SpillFile("b")

    def parts(self) -> Iterator[Part]:
        """All of them."""
        trace, attitudes = self._trace, self._trace.attitudes
        for rows in blocks(len(attitudes)):
            truth, known, errors = self._compared.part(rows)
            counted = known & (attitudes.times_of(rows) - self._begin_us >= self._skip_us)
            if len(self._moved) <= rows.start:
                some = counted.any()
                self._moved.add(motion_mask(trace.samples, rows) if some else counted)
            norths = attitudes.north_places(rows)[counted]
            yield Part(
                rows,
                counted,
                trace.column("q_ned_frd", rows)[counted],
                truth[counted],
                errors[counted],
                trace.column("sigma_inclination_rad", rows)[counted],
                trace.column("sigma_heading_rad", rows)[counted],
                norths,
                norths != NORTHS.index("none"),
                self._moved.rows(rows)[counted] > 0,
            )

    def turned(self) -> Iterator[Turned]:
        """What a constant turn is found by."""
        return (
            Turned(each.estimates, each.truth, each.sigma_inclination_rad, each.moved)
            for each in self.parts()
        )
