"""How well a replayed estimate did, against a reference."""

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from estimator.geometry.metrics import batch_angle_errors, rms

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

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


def summarize(errors_rad: Floats, *, has_heading: bool, told: Bools | None = None) -> ErrorSummary:
    """Figures over (N, 3) errors: total, heading, inclination; N may be 0.

    Total and heading leave out samples whose heading was not ``told`` (N,): there was none.
    """
    if len(errors_rad) == 0:
        return ErrorSummary()
    degrees = np.degrees(errors_rad)
    headed = degrees if told is None else degrees[told]
    has_heading = has_heading and len(headed) > 0
    return ErrorSummary(
        total_rms=rms(headed[:, 0]) if has_heading else None,
        heading_rms=rms(headed[:, 1]) if has_heading else None,
        inclination_rms=rms(degrees[:, 2]),
        inclination_p95=float(np.percentile(degrees[:, 2], 95.0)),
    )


def coverage(
    errors_rad: Floats,
    sigma_inclination: Floats,
    sigma_heading: Floats,
    *,
    has_heading: bool,
    told: Bools | None = None,
    moved: Bools | None = None,
) -> Coverage:
    """How often the error stayed under its sigma, always and while the vehicle ``moved`` (N,).

    Headings that were not ``told`` (N,) are left out.
    """
    n = len(errors_rad)
    everywhere, nowhere = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    headed = (everywhere if told is None else told) & has_heading
    moved = nowhere if moved is None else moved
    upright = errors_rad[:, 2] <= sigma_inclination
    pointed = errors_rad[:, 1] <= sigma_heading
    return Coverage(
        inclination=_share(upright),
        heading=_share(pointed[headed]),
        inclination_moving=_share(upright[moved]),
        heading_moving=_share(pointed[headed & moved]),
    )


def _share(inside: Bools) -> float | None:
    return float(np.mean(inside)) if len(inside) else None


def convergence_s(times_us: NDArray[np.int64], total_rad: Floats, known: Bools) -> float | None:
    """Time from the first sample with a reference until the total error is first under 5 deg."""
    compared = np.flatnonzero(known)
    if len(compared) == 0:
        return None
    good = compared[total_rad[compared] < CONVERGED_RAD]
    return float(times_us[good[0]] - times_us[compared[0]]) * 1e-6 if len(good) else None


def errors_against(estimates: Floats, reference: Floats) -> Floats:
    """(N, 3) rad: total, heading, inclination."""
    return np.asarray(batch_angle_errors(estimates, reference))


def sort_counts(counts: Mapping[str, int]) -> dict[str, int]:
    """Counts by name, so that equal runs print equal text."""
    return {name: counts[name] for name in sorted(counts)}
