"""How near a replayed estimate is to a reference, and what ``replay --json`` prints of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.logs.table import blocks
from estimator.arrays import Bools, Floats, Times
from estimator.errors import InputError
from estimator.filter.alignment import nearest_rotation
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.rotations import cross, rotate_inverse
from estimator.types import DOWN
from fuzzbee.replays.trace import VehicleTrace

CONVERGED_RAD = np.radians(5.0)
# What they are called for a person; the truth, a simulator's or a table's own, goes first
REFERENCES = {"sim": "truth", "autopilot": "autopilot"}


class VehicleSummary(msgspec.Struct, frozen=True):
    """Whose IMU it was; names as in MAVLink's enumerations, None without a HEARTBEAT."""

    system_id: int
    component_id: int
    autopilot: str | None
    type: str | None


class ImuSummary(msgspec.Struct, frozen=True):
    """What arrived; the arrival gap is of the log's stamps, the other of the vehicle's clock.

    ``message`` is the one that was used most, ``messages`` counts the samples used of each. The
    median rate is that of the stream while it comes, the mean what really came in a second.
    """

    message: str
    samples: int
    messages: dict[str, int]
    median_rate_hz: float | None
    mean_rate_hz: float | None
    worst_gap_s: float | None
    worst_arrival_gap_s: float | None
    rates: str = "imu"


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


class Retuning(msgspec.Struct, frozen=True):
    """A change of the profile while it ran: when, to what, why, and the share of the cost saved."""

    time_s: float
    reason: str
    gain: float
    update: dict[str, dict[str, float]]


class RetunedSummary(msgspec.Struct, frozen=True):
    """All changes while it ran."""

    count: int
    changes: list[Retuning]


class DifferenceSummary(msgspec.Struct, frozen=True):
    """A time for which the autopilot's attitude and ours differed, and the evidence."""

    begin_s: float
    end_s: float
    inclination_deg: float  # the largest
    heading_deg: float
    wrong: str  # "autopilot", "ours", or ""
    evidence: str


class Report(msgspec.Struct, frozen=True):
    """What every replay reports; errors and coverage are of the samples that count."""

    source: str
    vehicle: VehicleSummary
    imu: ImuSummary
    duration_s: float
    reference: str | None
    error_deg: ErrorSummary
    coverage: Coverage
    peers: dict[str, ErrorSummary]
    convergence_s: float | None
    mean_gain: float
    rejected: dict[str, int]
    wall_s: float


class LogReport(Report, frozen=True):
    """Schema of ``replay LOG --json``.

    ``heading_references`` counts the scored samples by what their heading is measured from.
    """

    heading_references: dict[str, int] = {}
    constant_turn: ConstantTurn | None = None
    differences: list[DifferenceSummary] = []  # from the autopilot's attitude
    agreement: dict[str, int] = {}  # how many looks ended with which verdict
    window_s: tuple[float, float] | msgspec.UnsetType = msgspec.UNSET  # with --from or --to only
    retuned: RetunedSummary | msgspec.UnsetType = msgspec.UNSET  # with --retune only
    profile: str | msgspec.UnsetType = msgspec.UNSET  # with several only


class SimulationReport(Report, frozen=True):
    """Schema of ``replay sim: --json``: that of a log, and the paper's figures."""

    seeds: tuple[int, int]
    cost: float
    cost_per_seed: list[float]
    steady_state_error: float
    settling_s: float | None


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

    parts = [*blocks(len(trace))]

    def errors(of: str) -> Iterator[Floats]:
        names = (of, "reference_q_ned_frd")  # not mapped for longer than a part takes
        return (batch_angle_errors(*(trace[name][rows] for name in names)) for rows in parts)

    trace.put("reference_q_ned_frd", (_attitudes(trace, trace.reference, rows) for rows in parts))
    trace.put("error_rad", errors("q_ned_frd"))
    if trace.has_peer:
        trace.put("autopilot_q_ned_frd", (_attitudes(trace, "autopilot", rows) for rows in parts))
        trace.put("autopilot_error_rad", errors("autopilot_q_ned_frd"))


def _attitudes(trace: VehicleTrace, source: str | None, rows: slice) -> Floats:
    """``q_ned_frd`` (N, 4) of the IMU; NaN where it is not known.

    The autopilot reports on the vehicle, or what its pilot is to see; the simulator's truth is the
    IMU's own.
    """
    times_us = trace["time_us"][rows]
    if source is None:
        return np.full((len(times_us), 4), np.nan)
    track = trace.references[source]
    shown = track.at(times_us)
    view = trace.vehicle.parameters.view
    if source == "autopilot" and track.message is not None and not view.is_imus:
        ours = trace["q_ned_frd"][rows]
        for k in np.flatnonzero(np.isfinite(shown[:, 0])).tolist():
            pair = tuple(shown[k].tolist()), tuple(ours[k].tolist())
            found = view.of_imu(track.message, *pair)
            shown[k] = np.nan if found is None else found
    return shown


def error_summary(error_rad: Floats, counted: Bools, has_heading: Bools) -> ErrorSummary:
    """The summary of errors (N, 3) that count (N,).

    Total and heading leave out samples (N,) without a heading.
    """
    if not counted.any():
        return ErrorSummary()
    total, heading, inclination = error_rad.T
    headed = counted & has_heading
    return ErrorSummary(
        total_rms=_rms_deg(total[headed]),
        heading_rms=_rms_deg(heading[headed]),
        inclination_rms=_rms_deg(inclination[counted]),
        inclination_p95=float(np.degrees(np.percentile(inclination[counted], 95.0))),
    )


def coverage(columns: Any, counted: Bools, has_heading: Bools, moved: Bools) -> Coverage:
    """How often errors that count (N,) stayed under their sigmas, always and while in motion."""
    shares: dict[str, float | None] = {}
    for name, i, known in (("inclination", 2, counted), ("heading", 1, counted & has_heading)):
        under = columns["error_rad"][:, i] <= columns[f"sigma_{name}_rad"]
        shares |= {name: mean(under[known]), f"{name}_moving": mean(under[known & moved])}
    return Coverage(**shares)


def convergence_s(times_us: Times, total_rad: Floats) -> float | None:
    """Time from the first sample with a reference until the total error is first under 5 deg."""
    is_known, is_good = ~np.isnan(total_rad), total_rad < CONVERGED_RAD
    begin, end = np.argmax(is_known), np.argmax(is_good)
    return 1e-6 * float(times_us[end] - times_us[begin]) if is_good.any() else None


def constant_turn(columns: Any, counted: Bools, moved: Bools) -> ConstantTurn | None:
    """The turn from estimate to reference of the samples that count (N,); None without any.

    R of the least sum of |R d - d_reference|^2 over down in the body d (Wahba's problem).
    ``moved`` (N,) shows of motion.
    """

    def downs() -> Iterator[list[Floats]]:
        for rows in blocks(len(counted)):
            both = (columns[name][rows] for name in ("q_ned_frd", "reference_q_ned_frd"))
            yield [rotate_inverse(q[counted[rows]], DOWN) for q in both]

    if not counted.any():
        return None
    turn = nearest_rotation(sum((theirs.T @ ours for ours, theirs in downs()), np.zeros((3, 3))))
    # twice, as all of them take more memory than time
    angles = [[_between(d @ turn.T, each) for each in (d, theirs)] for d, theirs in downs()]
    tilted, left = map(np.concatenate, zip(*angles, strict=True))
    under = left <= columns["sigma_inclination_rad"][counted]
    return ConstantTurn(
        float(np.degrees(rms(tilted))),
        float(np.degrees(rms(left))),
        float(np.mean(under)),
        mean(under[moved[counted]]),
    )


def mean(values: NDArray[Any]) -> float | None:
    """None where there are none."""
    return float(np.mean(values)) if len(values) else None


def _rms_deg(values_rad: Floats) -> float | None:
    return rms(np.degrees(values_rad)) if len(values_rad) else None


def _between(some: Floats, others: Floats) -> Floats:
    """Angles (N,) between unit vectors, rad."""
    sine = np.linalg.norm(cross(some, others), axis=1)
    return np.asarray(np.arctan2(sine, np.sum(some * others, axis=1)))
