"""How well a replayed estimate did, against a reference."""

from collections.abc import Mapping
from math import sqrt
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.logs.percentile import percentile
from drivers.logs.spill_file import SpillFile
from estimator.arrays import Bools, Floats
from estimator.geometry.metrics import batch_angle_errors

CONVERGED_RAD = np.radians(5.0)


class ErrorSummary(msgspec.Struct, frozen=True):
    """Degrees. Heading and total are None where there is no heading to speak of."""

    total_rms: float | None = None
    heading_rms: float | None = None
    inclination_rms: float | None = None
    inclination_p95: float | None = None


class Coverage(msgspec.Struct, frozen=True):
    """Share of samples whose error lies under the published sigma; honest is 0.68."""

    inclination: float | None = None
    heading: float | None = None
    inclination_moving: float | None = None
    heading_moving: float | None = None


class Means:
    """Means of numbers, by name, that come in parts."""

    def __init__(self) -> None:
        self._sums: dict[str, tuple[float, int]] = {}

    def add(self, name: str, values: NDArray[Any]) -> None:
        """Some more (N,) of that name."""
        total, n = self._sums.get(name, (0.0, 0))
        self._sums[name] = total + float(np.sum(values)), n + len(values)

    def mean(self, name: str) -> float | None:
        """None where there are none."""
        total, n = self._sums.get(name, (0.0, 0))
        return total / n if n else None

    def root(self, name: str) -> float | None:
        """The root of that mean."""
        mean = self.mean(name)
        return None if mean is None else sqrt(mean)


class Errors:
    """The summary of errors that come in parts: total, heading, inclination, rad.

    Total and heading leave out samples whose heading was not told: there was none.
    """

    def __init__(self, *, has_heading: bool) -> None:
        self._has_heading = has_heading
        self._squares = Means()
        self._inclination_deg = SpillFile("d")

    def add(self, errors_rad: Floats, told: Bools | None = None) -> None:
        """Errors (N, 3) and whether a heading was told (N,)."""
        degrees = np.degrees(errors_rad)
        headed = degrees if told is None else degrees[told]
        if self._has_heading:
            self._squares.add("total", np.square(headed[:, 0]))
            self._squares.add("heading", np.square(headed[:, 1]))
        self._squares.add("inclination", np.square(degrees[:, 2]))
        self._inclination_deg.add(degrees[:, 2])

    def summary(self) -> ErrorSummary:
        """All until now."""
        if not len(self._inclination_deg):
            return ErrorSummary()
        return ErrorSummary(
            total_rms=self._squares.root("total"),
            heading_rms=self._squares.root("heading"),
            inclination_rms=self._squares.root("inclination"),
            inclination_p95=percentile(self._inclination_deg.parts, 95.0),
        )


def summarize(errors_rad: Floats, *, has_heading: bool, told: Bools | None = None) -> ErrorSummary:
    """The summary of errors (N, 3), see :class:`Errors`; N may be 0."""
    errors = Errors(has_heading=has_heading)
    errors.add(errors_rad, told)
    return errors.summary()


class Covered:
    """How often errors stayed under their sigma, always and while the vehicle moved."""

    def __init__(self, *, has_heading: bool) -> None:
        self._has_heading = has_heading
        self._shares = Means()

    def add(
        self,
        errors_rad: Floats,
        sigma_inclination: Floats,
        sigma_heading: Floats,
        told: Bools | None = None,
        moved: Bools | None = None,
    ) -> None:
        """Errors (N, 3), sigmas (N,); headings that were not ``told`` (N,) are left out."""
        n = len(errors_rad)
        everywhere, nowhere = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
        headed = (everywhere if told is None else told) & self._has_heading
        moved = nowhere if moved is None else moved
        upright = errors_rad[:, 2] <= sigma_inclination
        pointed = errors_rad[:, 1] <= sigma_heading
        self._shares.add("inclination", upright)
        self._shares.add("heading", pointed[headed])
        self._shares.add("inclination_moving", upright[moved])
        self._shares.add("heading_moving", pointed[headed & moved])

    def coverage(self) -> Coverage:
        """All until now."""
        return Coverage(**{name: self._shares.mean(name) for name in Coverage.__struct_fields__})


class Convergence:
    """Time from the first sample with a reference until the total error is first under 5 deg."""

    def __init__(self) -> None:
        self._begin_us: int | None = None
        self.time_s: float | None = None

    def add(self, times_us: NDArray[np.int64], total_rad: Floats, known: Bools) -> None:
        """More samples (N,)."""
        times_us, total_rad = times_us[known], total_rad[known]
        if self._begin_us is None and len(times_us):
            self._begin_us = int(times_us[0])
        good_us = times_us[total_rad < CONVERGED_RAD]
        if self._begin_us is not None and self.time_s is None and len(good_us):
            self.time_s = float(good_us[0] - self._begin_us) * 1e-6


def errors_against(estimates: Floats, reference: Floats) -> Floats:
    """(N, 3) rad: total, heading, inclination."""
    return np.asarray(batch_angle_errors(estimates, reference))


def sort_counts(counts: Mapping[str, int]) -> dict[str, int]:
    """Counts by name, so that equal runs print equal text."""
    return {name: counts[name] for name in sorted(counts)}
