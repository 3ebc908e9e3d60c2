"""How well a replayed estimate did, against a reference."""

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.logs.table import blocks
from estimator.arrays import Bools, Floats, Times
from estimator.geometry.rotations import cross, rotate_inverse
from estimator.types import DOWN

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


class ConstantTurn(msgspec.Struct, frozen=True):
    """One turn of the body that fits best, and what is left of the inclination's errors without.

    ``turn_deg`` is by how much it tilts the vertical, RMS over the samples.
    """

    turn_deg: float
    inclination_rms: float
    inclination_coverage: float
    inclination_coverage_moving: float | None


def errors_of(columns: Any, i: int, name: str = "error_rad") -> Floats:
    """Of errors the total (0), the heading's (1) or the inclination's (2), (N,).

    Part by part: a column that is mapped counts as memory while it is held.
    """
    found = np.empty(len(columns["time_us"]))
    for rows in blocks(len(found)):
        found[rows] = columns[name][rows][:, i]
    return found


def error_summary(
    columns: Any, counted: Bools, has_heading: Bools, name: str = "error_rad"
) -> ErrorSummary:
    """The summary of errors that count (N,).

    Total and heading leave out samples (N,) without a heading.
    """
    if not counted.any():
        return ErrorSummary()
    inclination = errors_of(columns, 2, name)[counted]
    return ErrorSummary(
        total_rms=_rms_deg(errors_of(columns, 0, name)[counted & has_heading]),
        heading_rms=_rms_deg(errors_of(columns, 1, name)[counted & has_heading]),
        inclination_rms=_rms_deg(inclination),
        inclination_p95=float(np.degrees(np.percentile(inclination, 95.0))),
    )


def coverage(columns: Any, counted: Bools, has_heading: Bools, moved: Bools) -> Coverage:
    """How often errors that count (N,) stayed under their sigmas, always and while in motion."""
    upright = errors_of(columns, 2) <= columns["sigma_inclination_rad"]
    pointed = errors_of(columns, 1) <= columns["sigma_heading_rad"]
    return Coverage(
        inclination=mean(upright[counted]),
        heading=mean(pointed[counted & has_heading]),
        inclination_moving=mean(upright[counted & moved]),
        heading_moving=mean(pointed[counted & has_heading & moved]),
    )


def convergence_s(times_us: Times, total_rad: Floats) -> float | None:
    """Time from the first sample with a reference until the total error is first under 5 deg."""
    is_known, is_good = ~np.isnan(total_rad), total_rad < CONVERGED_RAD
    begin, end = np.argmax(is_known), np.argmax(is_good)
    return 1e-6 * float(times_us[end] - times_us[begin]) if is_good.any() else None


def constant_turn(columns: Any, counted: Bools, moved: Bools) -> ConstantTurn | None:
    """The turn from estimate to reference of the samples that count (N,); None without any.

    R of the least sum of |R d - d_reference|^2 over down in the body d (Wahba's problem, by SVD:
    F. L. Markley 1988). ``moved`` (N,) shows of motion.
    """

    def downs() -> Iterator[tuple[slice, Floats, Floats]]:
        for rows in blocks(len(counted)):
            both = (columns[name][rows] for name in ("q_ned_frd", "reference_q_ned_frd"))
            ours, theirs = (rotate_inverse(q[counted[rows]], DOWN) for q in both)
            yield rows, ours, theirs

    if not counted.any():
        return None
    u, _, vt = np.linalg.svd(sum(theirs.T @ ours for _, ours, theirs in downs()))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    under, tilted, left = np.zeros_like(counted), 0.0, 0.0
    for rows, ours, theirs in downs():
        turned = ours @ turn.T
        apart = _between(turned, theirs)
        tilted += float(np.sum(_between(turned, ours) ** 2))
        left += float(np.sum(apart**2))
        sigma = columns["sigma_inclination_rad"][rows][counted[rows]]
        under[rows][counted[rows]] = apart <= sigma
    count = int(np.count_nonzero(counted))
    return ConstantTurn(
        turn_deg=float(np.degrees(np.sqrt(tilted / count))),
        inclination_rms=float(np.degrees(np.sqrt(left / count))),
        inclination_coverage=float(np.count_nonzero(under)) / count,
        inclination_coverage_moving=mean(under[counted & moved]),
    )


def mean(values: NDArray[Any]) -> float | None:
    """None where there are none."""
    return float(np.mean(values)) if len(values) else None


def _rms_deg(values_rad: Floats) -> float | None:
    degrees = np.degrees(values_rad)
    np.square(degrees, out=degrees)
    return float(np.sqrt(np.mean(degrees))) if len(degrees) else None


def _between(some: Floats, others: Floats) -> Floats:
    """Angles (N,) between unit vectors, rad."""
    sine = np.linalg.norm(cross(some, others), axis=1)
    return np.asarray(np.arctan2(sine, np.sum(some * others, axis=1)))
