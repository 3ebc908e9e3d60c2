"""How near a replayed estimate is to a reference: the figures of ``replay LOG``."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from drivers.logs.reference_track import attitudes_at
from drivers.logs.table import blocks
from drivers.mavlink.constants import enum_name
from estimator.errors import InputError
from estimator.filter.alignment import nearest_rotation
from estimator.geometry.metrics import batch_angle_errors, rms
from estimator.geometry.rotations import cross, rotate_inverse
from estimator.live.rows import NORTHS
from estimator.profile import Profile
from estimator.types import DOWN, Bools, Floats, Times
from fuzzbee.attitudes import PLACE
from fuzzbee.notify import printable
from fuzzbee.replays import report
from fuzzbee.replays.motion import motion_mask
from fuzzbee.replays.trace import AS_LIVE, How, VehicleTrace, replay_log
from tuning.online.retuner import RetunedEstimator

CONVERGED_RAD = np.radians(5.0)


def report_log(
    path: Path,
    profile: Profile,
    how: How = AS_LIVE,
    reference: str | None = None,
    skip_s: float = 0.0,
) -> tuple[VehicleTrace, report.LogReport]:
    """Replay a log, compare it and score it.

    Raises:
        InputError: the log cannot be replayed, lacks the reference, or ends before ``skip_s``.
    """
    started = time.perf_counter()
    trace = replay_log(path, profile, how)
    compare(trace, reference)
    found = score(trace, skip_s)
    if how.start_wrong_deg:
        other = how._replace(system_id=trace.address.system_id, start_wrong_deg=0.0)
        right = replay_log(path, profile, other)
        # beside the attitude without a wrong start: beside the truth it would count what is learnt
        # of the declination or the vertical meanwhile; another IMU may stand in after a turn
        since = int(np.searchsorted(trace["time_us"], trace.turned_at_us or 0))
        times_us, q = trace["time_us"][since:], trace["q_ned_frd"][since:]
        beside = attitudes_at(times_us, right["time_us"], right["q_ned_frd"])
        forgotten_s = convergence_s(times_us, batch_angle_errors(q, beside)[:, 0])
        found = replace(found, convergence_s=forgotten_s)
    return trace, replace(found, wall_s=time.perf_counter() - started)


def compare(trace: VehicleTrace, wanted: str | None) -> None:
    """Put the wanted reference, or the best there is, beside the trace, whose ``reference`` it is.

    Columns: ``reference_q_ned_frd`` (N, 4) and ``error_rad`` (N, 3: total, heading, inclination),
    and beside a truth ``autopilot_q_ned_frd`` and ``autopilot_error_rad``. NaN where not known.
    """
    if wanted is not None and wanted not in trace.available:
        raise InputError(
            f"{trace.log.path}: no reference '{wanted}' for vehicle {trace.address.system_id}"
            f" (there is: {', '.join(trace.available) or 'none'})"
        )
    trace.reference = wanted or next(iter(trace.available), None)
    source = trace.reference or "sim"  # which has none then
    trace.put("reference_q_ned_frd", _attitudes(trace, source))
    trace.put("error_rad", _errors(trace, "q_ned_frd"))
    if trace.has_peer:
        trace.put("autopilot_q_ned_frd", _attitudes(trace, "autopilot"))
        trace.put("autopilot_error_rad", _errors(trace, "autopilot_q_ned_frd"))


def _attitudes(trace: VehicleTrace, source: str) -> Iterator[Floats]:
    """``q_ned_frd`` (N, 4) of the IMU, in parts; NaN where it is not known.

    The autopilot reports on the vehicle, or what its pilot is to see; the simulator's truth is the
    IMU's own.
    """
    track, view = trace.references[source], trace.vehicle.parameters.view
    message, is_view = track.message or "", source == "autopilot" and not view.is_imus
    for rows in blocks(len(trace)):
        shown = track.at(trace["time_us"][rows])
        ours = trace["q_ned_frd"][rows]
        for k in np.flatnonzero(np.isfinite(shown[:, 0])).tolist() if is_view else ():
            pair = tuple(shown[k].tolist()), tuple(ours[k].tolist())
            shown[k] = view.of_imu(message, *pair) or np.nan
        yield shown


def _errors(trace: VehicleTrace, of: str) -> Iterator[Floats]:
    """The errors (N, 3) of a column's attitudes, in parts."""
    for rows in blocks(len(trace)):
        yield batch_angle_errors(trace[of][rows], trace["reference_q_ned_frd"][rows])


def score(trace: VehicleTrace, skip_s: float) -> report.LogReport:
    """The figures of a trace that has been compared."""
    times_us, norths = trace["time_us"], trace["heading_reference"]
    begin_s, end_s = trace.time_s[[0, -1]].tolist()
    lasts_s = 1e-6 * float(times_us[-1] - times_us[0])
    total_rad = trace["error_rad"][:, 0].copy()  # not a view, that the column is let go
    counted = ~np.isnan(total_rad)
    counted[: int(np.searchsorted(times_us, times_us[0] + 1e6 * skip_s))] = False
    if skip_s > 0.0 and not counted.any():
        what = f"nothing is left to score after {skip_s:g} s of {lasts_s:.0f} s"
        raise InputError(f"{trace.log.path}: {what}")
    moved = motion_mask(trace) if counted.any() else counted
    has_heading = norths > PLACE["none"]
    peers = {}
    if trace.has_peer:  # which all has a heading
        theirs = trace["autopilot_error_rad"]
        both = counted & ~np.isnan(theirs[:, 0])
        peers["autopilot"] = error_summary(theirs, both, both)
    kinds = zip(("MAV_AUTOPILOT", "MAV_TYPE"), trace.kind, strict=True)
    names = (None if number is None else enum_name(enum, number) for enum, number in kinds)
    counts = zip(NORTHS, np.bincount(norths[counted], minlength=len(NORTHS)).tolist(), strict=True)
    return report.LogReport(
        source=printable(str(trace.log.path)),
        vehicle=report.VehicleSummary(*trace.address, *names),
        imu=_imu_summary(trace),
        duration_s=lasts_s,
        reference=trace.reference,
        error_deg=error_summary(trace["error_rad"], counted, has_heading),
        coverage=coverage(trace, counted, has_heading, moved),
        peers=peers,
        convergence_s=convergence_s(times_us, total_rad) if trace.has_heading else None,
        mean_gain=float(np.mean(trace["gain"])),
        rejected=by_name(trace.rejected),
        heading_references=by_name({north: n for north, n in counts if n}),
        constant_turn=constant_turn(trace, counted, moved),
        differences=differences_of(trace),
        agreement=verdicts(trace),
        window_s=msgspec.UNSET if trace.log_zero_us is None else (begin_s, end_s),
        retuned=_retuned(trace),
    )


def by_name(counts: Mapping[str, Any]) -> dict[str, Any]:
    """Counts in the order of their names, so that equal runs print equal text."""
    return dict(sorted(counts.items()))


def verdicts(trace: VehicleTrace) -> dict[str, int]:
    """How many comparisons of both attitudes have ended with which verdict."""
    return by_name({word.value: n for word, n in trace.vehicle.comparison.looks.items()})


def differences_of(trace: VehicleTrace) -> list[report.DifferenceSummary]:
    """When the autopilot's attitude differed from ours, in seconds of the log."""
    zero_us, found = trace.zero_us, []
    for begin_us, end_us, *angles_deg, wrong, evidence in trace.vehicle.comparison.intervals:
        span_s = (1e-6 * (us - zero_us) for us in (begin_us, end_us))
        begin_s, end_s, tilt, turn = (round(value, 1) for value in (*span_s, *angles_deg))
        found.append(report.DifferenceSummary(begin_s, end_s, tilt, turn, wrong, evidence))
    return found


def _retuned(trace: VehicleTrace) -> report.RetunedSummary | msgspec.UnsetType:
    estimator = trace.vehicle.estimator
    if not isinstance(estimator, RetunedEstimator):
        return msgspec.UNSET
    changes = [
        report.Retuning((time_us - trace.zero_us) * 1e-6, made.reason, made.gain, made.update)
        for time_us, made in estimator.decisions
    ]
    return report.RetunedSummary(len(changes), changes)


def _imu_summary(trace: VehicleTrace) -> report.ImuSummary:
    steps_s, gaps_s = (1e-6 * np.diff(trace[name]) for name in ("time_us", "arrival_us"))
    figures: tuple[Any, Any, Any, Any] = (None, None, None, None)
    if len(steps_s):
        rates_hz = 1.0 / float(np.median(steps_s)), 1.0 / float(np.mean(steps_s))
        figures = (*rates_hz, float(steps_s.max()), float(gaps_s.max()))
    counts, rates = dict(trace.imu_messages.most_common()), trace.vehicle.estimator.rates
    return report.ImuSummary(trace.message, len(trace), counts, *figures, rates)


def error_summary(error_rad: Floats, counted: Bools, has_heading: Bools) -> report.ErrorSummary:
    """The summary of errors (N, 3) that count (N,); total and heading where there is a heading."""
    if not counted.any():
        return report.ErrorSummary()
    total, heading, inclination = error_rad.T
    headed = counted & has_heading
    return report.ErrorSummary(
        _rms_deg(total[headed]),  # copies one by one, as each takes much memory
        _rms_deg(heading[headed]),
        _rms_deg(inclination[counted]),
        float(np.degrees(np.percentile(inclination[counted], 95.0))),
    )


def coverage(columns: Any, counted: Bools, has_heading: Bools, moved: Bools) -> report.Coverage:
    """How often errors that count (N,) stayed under their sigmas, always and while in motion."""
    shares: dict[str, float | None] = {}
    for name, i, known in (("inclination", 2, counted), ("heading", 1, counted & has_heading)):
        under = columns["error_rad"][:, i] <= columns[f"sigma_{name}_rad"]
        shares |= {name: mean(under[known]), f"{name}_moving": mean(under[known & moved])}
    return report.Coverage(**shares)


def convergence_s(times_us: Times, total_rad: Floats) -> float | None:
    """Time from the first sample with a reference until the total error is first under 5 deg."""
    is_known, is_good = ~np.isnan(total_rad), total_rad < CONVERGED_RAD
    begin, end = np.argmax(is_known), np.argmax(is_good)
    return 1e-6 * float(times_us[end] - times_us[begin]) if is_good.any() else None


def constant_turn(columns: Any, counted: Bools, moved: Bools) -> report.ConstantTurn | None:
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
    return report.ConstantTurn(
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
