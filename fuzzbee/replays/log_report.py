"""One log replayed and scored: the figures of ``replay LOG``."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.events import ReferenceAttitude
from drivers.logs.log_file import LogFile
from drivers.logs.missing_imu import advice
from drivers.logs.open import open_log
from drivers.logs.percentile import percentile
from drivers.logs.reference_track import ReferenceTrack
from drivers.logs.spill_file import blocks
from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from drivers.mavlink.constants import autopilot_name, vehicle_type_name
from estimator.arrays import Floats
from estimator.errors import InputError
from estimator.profile import Profile
from fuzzbee.column_store import NORTHS
from fuzzbee.replays.comparison import Comparison, compare, reference_attitudes
from fuzzbee.replays.constant_turn import ConstantTurn, constant_turn
from fuzzbee.replays.score import (
    Convergence,
    Coverage,
    Covered,
    Errors,
    ErrorSummary,
    Means,
    errors_against,
    sort_counts,
)
from fuzzbee.replays.scored import MICROSECOND, Scored
from fuzzbee.replays.smoothed import recorder, smooth_trace
from fuzzbee.replays.trace import Replay, VehicleTrace
from fuzzbee.say import printable

Reading = Callable[[LogFile], AbstractContextManager[object]]
Export = Callable[[VehicleTrace, Comparison], None]

MUCH_REFUSED = 0.1  # of all readings, that a person is told of
MOST_REASONS = 3  # that are named then


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
    """A time for which the autopilot's attitude and ours differed, and what speaks for whom."""

    begin_s: float
    end_s: float
    inclination_deg: float  # the largest
    heading_deg: float
    wrong: str  # "autopilot", "ours", or ""
    evidence: str


class LogReport(msgspec.Struct, frozen=True):
    """Schema of ``replay LOG --json``.

    ``heading_references`` counts the scored samples by what their heading is measured from.
    """

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
    heading_references: dict[str, int] = {}
    constant_turn: ConstantTurn | None = None
    differences: list[DifferenceSummary] = []  # from the autopilot's attitude
    agreement: dict[str, int] = {}  # how many looks ended with which verdict
    window_s: tuple[float, float] | msgspec.UnsetType = msgspec.UNSET  # with --from or --to only
    retuned: RetunedSummary | msgspec.UnsetType = msgspec.UNSET  # with --retune only
    profile: str | msgspec.UnsetType = msgspec.UNSET  # with several only


def report_log(
    path: Path,
    profile: Profile,
    *,
    fixed_gain: float | None = None,
    reference: str | None = None,
    skip_s: float = 0.0,
    start_wrong_deg: float = 0.0,
    system_id: int | None = None,
    retune: bool = False,
    smooth: bool = False,
    columns: Path | None = None,
    window: TimeWindow = WHOLE_LOG,
    profile_name: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
    exports: Sequence[Export] = (),
    reading: Reading = nullcontext,
) -> LogReport:
    """Replay a log and score it; ``exports`` are given the trace and its comparison.

    With ``smooth`` the attitudes are those that the whole log tells. ``columns`` describes a table.
    Only ``window`` of the log is read; its seconds go on counting from the log's beginning.
    ``reading`` is entered with the log while it is read.

    Raises:
        InputError: the log cannot be read, holds no IMU data of that vehicle, or lacks the
            reference that was asked for.
    """
    started = time.perf_counter()
    replayed = partial(
        replay_log,
        *(path, profile),
        fixed_gain=fixed_gain,
        retune=retune,
        smooth=smooth,
        columns=columns,
        window=window,
        reading=reading,
    )
    whose = "" if profile_name is None else f" with {profile_name}"

    def tell_of(text: str) -> None:
        tell(f"{path.name}{whose}: {text}")

    trace = replayed(start_wrong_deg=start_wrong_deg, system_id=system_id, tell=tell_of)
    compared = compare(path, trace, reference)
    report = score(path, trace, compared, skip_s)
    if start_wrong_deg:
        forgotten_s = _forgotten_s(trace, replayed(system_id=trace.address.system_id))
        report = msgspec.structs.replace(report, convergence_s=forgotten_s)
    for write in exports:
        write(trace, compared)
    return msgspec.structs.replace(
        report, wall_s=time.perf_counter() - started, profile=profile_name or msgspec.UNSET
    )


def _forgotten_s(trace: VehicleTrace, right: VehicleTrace) -> float | None:
    """When nothing is left of a wrong start (s after it): the attitude beside that without it.

    Beside the truth it would count what is learnt of the declination or the vertical meanwhile.
    """
    track = ReferenceTrack()  # another IMU may stand in after a turn: at other times
    for each in right.attitudes:
        track.add(ReferenceAttitude(right.address, 0, each.time_us, "sim", "right", each.q_ned_frd))
    forgotten = Convergence()
    for rows in blocks(len(trace.attitudes)):
        times_us = trace.attitudes.times_of(rows)
        beside, known = track.at(times_us)
        apart = errors_against(trace.column("q_ned_frd", rows), beside)[:, 0]
        forgotten.add(times_us, apart, known & (times_us >= (trace.turned_at_us or 0)))
    return forgotten.time_s


def replay_log(
    path: Path,
    profile: Profile,
    *,
    fixed_gain: float | None = None,
    start_wrong_deg: float = 0.0,
    system_id: int | None = None,
    retune: bool = False,
    smooth: bool = False,
    columns: Path | None = None,
    window: TimeWindow = WHOLE_LOG,
    tell: Callable[[str], None] = lambda _: None,
    reading: Reading = nullcontext,
) -> VehicleTrace:
    """The trace of the vehicle with most IMU samples, or of the one with ``system_id``."""
    replay = Replay(
        profile,
        fixed_gain=fixed_gain,
        system_id=system_id,
        start_wrong_deg=start_wrong_deg,
        retune=retune,
        tell=tell,
        new_estimator=recorder(fixed_gain) if smooth else None,
        window=window,
    )
    with open_log(path, columns) as log, reading(log):
        replay.run(log)
    trace = replay.longest()
    if trace is None:
        whose = "" if system_id is None else f" of system id {system_id}"
        seen = _seen_text(replay)
        way_out = replay.why_empty or advice(log, system_id)
        raise InputError(f"{path}: {way_out or f'no IMU data{whose} that can be used{seen}'}")
    if (refused := refused_text(trace)) is not None:
        tell(refused)
    if smooth:
        smooth_trace(trace, replay.estimator(trace.address))
    return trace


def refused_text(trace: VehicleTrace) -> str | None:
    """One line, where a good part of the log was refused."""
    counts = trace.rejected + Counter(malformed=trace.malformed)
    used = len(trace.attitudes)
    if counts.total() <= MUCH_REFUSED * (counts.total() + used):
        return None
    reasons = ", ".join(f"{n} x {reason}" for reason, n in counts.most_common(MOST_REASONS))
    return f"much was refused: {reasons}; {used} samples were used"


def _seen_text(replay: Replay) -> str:
    """What the log has instead of usable IMU data, for the error message."""
    ids = sorted({address.system_id for address in replay.traces})
    refused = sum((trace.rejected for trace in replay.traces.values()), start=Counter[str]())
    if refused:
        return ": " + ", ".join(f"{n} x {reason}" for reason, n in sorted(refused.items()))
    ids = ids or sorted(replay.pipeline.heard)
    if ids:
        return f" (vehicles seen: {', '.join(map(str, ids))})"
    malformed = replay.pipeline.malformed
    return f": {malformed} x malformed" if malformed else ""


def score(path: Path, trace: VehicleTrace, compared: Comparison, skip_s: float) -> LogReport:
    """The figures of a trace beside its reference."""
    attitudes, source = trace.attitudes, compared.source
    begin_us, end_us = attitudes[0].time_us, attitudes[-1].time_us
    has_heading = trace.has_heading
    scored = Scored(trace, compared, skip_s)
    errors, covered = Errors(has_heading=has_heading), Covered(has_heading=has_heading)
    autopilot = Errors(has_heading=True)
    has_peer = source == "sim" and trace.references["autopilot"].message is not None
    converged, gain, norths = Convergence(), Means(), np.zeros(len(NORTHS), np.int64)
    for part in scored.parts():
        sigmas = part.sigma_inclination_rad, part.sigma_heading_rad
        errors.add(part.errors_rad, part.told)
        covered.add(part.errors_rad, *sigmas, part.told, part.moved)
        norths += np.bincount(part.norths, minlength=len(NORTHS))
        gain.add("gain", trace.column("gain", part.rows))
        _, known, all_errors = compared.part(part.rows)
        times_us = attitudes.times_of(part.rows)
        since = known & (times_us >= (trace.turned_at_us or 0))
        converged.add(times_us, all_errors[:, 0], since)
        if has_peer:
            own, is_known = reference_attitudes(trace, "autopilot", part.rows)
            both = is_known[part.counted]
            autopilot.add(errors_against(own[part.counted], part.truth)[both])
    if skip_s > 0.0 and not norths.any():
        lasts_s = (end_us - begin_us) * MICROSECOND
        raise InputError(f"{path}: nothing is left to score after {skip_s:g} s of {lasts_s:.0f} s")
    return LogReport(
        source=printable(str(path)),
        vehicle=_vehicle_summary(trace),
        imu=_imu_summary(trace),
        duration_s=float(end_us - begin_us) * MICROSECOND,
        reference=source,
        error_deg=errors.summary(),
        coverage=covered.coverage(),
        peers={"autopilot": autopilot.summary()} if has_peer else {},
        convergence_s=converged.time_s if has_heading else None,
        mean_gain=gain.mean("gain") or 0.0,
        rejected=sort_counts(trace.rejected + Counter(malformed=trace.malformed)),
        wall_s=0.0,
        heading_references=sort_counts(counts_of(norths)),
        constant_turn=constant_turn(scored.turned),
        differences=differences_of(trace),
        agreement=verdicts(trace),
        window_s=_window_s(trace),
        retuned=_retuned_summary(trace),
    )


def _window_s(trace: VehicleTrace) -> tuple[float, float] | msgspec.UnsetType:
    if trace.log_zero_us is None:
        return msgspec.UNSET
    first_us, last_us = trace.attitudes[0].time_us, trace.attitudes[-1].time_us
    return (
        (first_us - trace.log_zero_us) * MICROSECOND,
        (last_us - trace.log_zero_us) * MICROSECOND,
    )


def counts_of(norths: NDArray[np.int64]) -> dict[str, int]:
    """How many headings are measured from which north."""
    return {north: n for north, n in zip(NORTHS, norths.tolist(), strict=True) if n}


def verdicts(trace: VehicleTrace) -> dict[str, int]:
    """How many looks at both attitudes have ended with which word."""
    return sort_counts({word.value: n for word, n in trace.second_opinion.looks.items()})


def differences_of(trace: VehicleTrace) -> list[DifferenceSummary]:
    """When the autopilot's attitude differed from ours, in seconds of the log."""
    begun_us = trace.zero_us
    return [
        DifferenceSummary(
            begin_s=round((each.begin_us - begun_us) * MICROSECOND, 1),
            end_s=round((each.end_us - begun_us) * MICROSECOND, 1),
            inclination_deg=round(each.inclination_deg, 1),
            heading_deg=round(each.heading_deg, 1),
            wrong=each.wrong,
            evidence=each.evidence,
        )
        for each in trace.second_opinion.intervals
    ]


def _retuned_summary(trace: VehicleTrace) -> RetunedSummary | msgspec.UnsetType:
    if trace.decisions is None:
        return msgspec.UNSET
    begun_us = trace.zero_us
    changes = [
        Retuning(
            time_s=(time_us - begun_us) * MICROSECOND,
            reason=decision.reason,
            gain=decision.gain,
            update=decision.update,
        )
        for time_us, decision in trace.decisions
    ]
    return RetunedSummary(len(changes), changes)


def _vehicle_summary(trace: VehicleTrace) -> VehicleSummary:
    return VehicleSummary(
        trace.address.system_id,
        trace.address.component_id,
        None if trace.autopilot is None else autopilot_name(trace.autopilot),
        None if trace.vehicle_type is None else vehicle_type_name(trace.vehicle_type),
    )


def _imu_summary(trace: VehicleTrace) -> ImuSummary:
    means = Means()
    for steps_s in trace.attitudes.steps_s():
        means.add("step", steps_s)
    mean_s, median_s = means.mean("step"), percentile(trace.attitudes.steps_s, 50.0)
    return ImuSummary(
        message=max(trace.imu_messages, key=lambda name: trace.imu_messages[name], default=""),
        samples=len(trace.attitudes),
        messages=dict(trace.imu_messages.most_common()),
        median_rate_hz=1.0 / median_s if mean_s else None,
        mean_rate_hz=1.0 / mean_s if mean_s else None,
        worst_gap_s=_longest(trace.attitudes.steps_s()),
        worst_arrival_gap_s=_longest(MICROSECOND * part for part in trace.arrivals_us.steps()),
        rates=trace.rates,
    )


def _longest(parts: Iterable[Floats]) -> float | None:
    return max((float(part.max()) for part in parts if len(part)), default=None)
