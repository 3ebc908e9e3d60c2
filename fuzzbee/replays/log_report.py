"""One log replayed and scored: the figures of ``replay LOG``."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TypedDict, Unpack

import msgspec
import numpy as np

from drivers.logs.log_file import LogFile
from drivers.logs.missing_imu import advice
from drivers.logs.open import open_log
from drivers.logs.reference_track import attitudes_at
from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from drivers.mavlink.constants import autopilot_name, vehicle_type_name
from estimator.arrays import Bools
from estimator.errors import InputError
from estimator.geometry.metrics import batch_angle_errors
from estimator.live.rows import NORTHS
from estimator.profile import Profile
from fuzzbee.attitudes import PLACE
from fuzzbee.notify import printable
from fuzzbee.replays.comparison import compare, has_peer
from fuzzbee.replays.motion import motion_mask
from fuzzbee.replays.score import (
    ConstantTurn,
    Coverage,
    ErrorSummary,
    constant_turn,
    convergence_s,
    coverage,
    error_summary,
    errors_of,
)
from fuzzbee.replays.smoothed import recorder, smooth_trace
from fuzzbee.replays.trace import Replay, VehicleTrace

Reading = Callable[[LogFile], AbstractContextManager[object]]
Export = Callable[[VehicleTrace], None]

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


class How(TypedDict, total=False):
    """How a log is replayed.

    ``fixed_gain`` stands in for the fuzzy one. Of several vehicles it is the one with
    ``system_id``, or with most IMU samples. With ``retune`` a few numbers of the profile are
    retuned on the way, with ``smooth`` the attitudes are those that the whole log shows.
    ``columns`` describes a table. Only ``window`` is read; its seconds count from the log's
    beginning. ``reading`` is entered with the log while it is read.
    """

    fixed_gain: float | None
    system_id: int | None
    retune: bool
    smooth: bool
    columns: Path | None
    window: TimeWindow
    reading: Reading


def report_log(
    path: Path,
    profile: Profile,
    *,
    reference: str | None = None,
    skip_s: float = 0.0,
    start_wrong_deg: float = 0.0,
    profile_name: str | None = None,
    tell: Callable[[str], None] = lambda _: None,
    exports: Sequence[Export] = (),
    **how: Unpack[How],
) -> LogReport:
    """Replay a log and score it; ``exports`` are given the compared trace.

    Raises:
        InputError: the log cannot be read, holds no IMU data of that vehicle, or lacks the
            reference that was asked for.
    """
    started = time.perf_counter()
    whose = "" if profile_name is None else f" with {profile_name}"

    def tell_of(text: str) -> None:
        tell(f"{path.name}{whose}: {text}")

    trace = replay_log(path, profile, start_wrong_deg=start_wrong_deg, tell=tell_of, **how)
    compare(path, trace, reference)
    report = score(path, trace, skip_s)
    if start_wrong_deg:
        how["system_id"] = trace.address.system_id
        forgotten_s = _forgotten_s(trace, replay_log(path, profile, **how))
        report = msgspec.structs.replace(report, convergence_s=forgotten_s)
    for write in exports:
        write(trace)
    return msgspec.structs.replace(
        report, wall_s=time.perf_counter() - started, profile=profile_name or msgspec.UNSET
    )


def _forgotten_s(trace: VehicleTrace, right: VehicleTrace) -> float | None:
    """When nothing is left of a wrong start (s after it): the attitude beside that without it.

    Beside the truth it would count what is learnt of the declination or the vertical meanwhile.
    """
    since = int(np.searchsorted(trace["time_us"], trace.turned_at_us or 0))
    times_us = trace["time_us"][since:]
    # another IMU may stand in after a turn: at other times
    beside = attitudes_at(times_us, right["time_us"], right["q_ned_frd"])
    return convergence_s(times_us, batch_angle_errors(trace["q_ned_frd"][since:], beside)[:, 0])


def replay_log(
    path: Path,
    profile: Profile,
    *,
    start_wrong_deg: float = 0.0,
    tell: Callable[[str], None] = lambda _: None,
    **how: Unpack[How],
) -> VehicleTrace:
    """The trace of one vehicle.

    Raises:
        InputError: see :func:`report_log`.
    """
    fixed_gain, system_id, smooth = how.get("fixed_gain"), how.get("system_id"), how.get("smooth")
    replay = Replay(
        profile,
        fixed_gain=fixed_gain,
        system_id=system_id,
        start_wrong_deg=start_wrong_deg,
        retune=how.get("retune", False),
        tell=tell,
        new_estimator=recorder(fixed_gain) if smooth else None,
        window=how.get("window", WHOLE_LOG),
    )
    with open_log(path, how.get("columns")) as log, how.get("reading", nullcontext)(log):
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
    used = len(trace)
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


def score(path: Path, trace: VehicleTrace, skip_s: float) -> LogReport:
    """The figures of a trace that has been compared.

    Raises:
        InputError: nothing is left to score after ``skip_s``.
    """
    times_us = trace["time_us"]
    lasts_s = 1e-6 * float(times_us[-1] - times_us[0])
    counted = ~np.isnan(errors_of(trace, 0))
    counted[: int(np.searchsorted(times_us, times_us[0] + 1e6 * skip_s))] = False
    if skip_s > 0.0 and not counted.any():
        raise InputError(f"{path}: nothing is left to score after {skip_s:g} s of {lasts_s:.0f} s")
    moved = motion_mask(trace) if counted.any() else counted
    norths = trace["heading_reference"]
    has_heading = (norths > PLACE["none"]) & trace.has_heading
    turned = int(np.searchsorted(times_us, trace.turned_at_us or 0))
    converged = convergence_s(times_us[turned:], errors_of(trace, 0)[turned:])
    counts = zip(NORTHS, np.bincount(norths[counted], minlength=len(NORTHS)).tolist(), strict=True)
    return LogReport(
        source=printable(str(path)),
        vehicle=_vehicle_summary(trace),
        imu=_imu_summary(trace),
        duration_s=lasts_s,
        reference=trace.reference,
        error_deg=error_summary(trace, counted, has_heading),
        coverage=coverage(trace, counted, has_heading, moved),
        peers={"autopilot": _peer(trace, counted)} if has_peer(trace) else {},
        convergence_s=converged if trace.has_heading else None,
        mean_gain=float(np.mean(trace["gain"])),
        rejected=sort_counts(trace.rejected + Counter(malformed=trace.malformed)),
        wall_s=0.0,
        heading_references=sort_counts({north: n for north, n in counts if n}),
        constant_turn=constant_turn(trace, counted, moved),
        differences=differences_of(trace),
        agreement=verdicts(trace),
        window_s=_window_s(trace),
        retuned=_retuned_summary(trace),
    )


def _peer(trace: VehicleTrace, counted: Bools) -> ErrorSummary:
    """The autopilot's own errors, all with a heading."""
    name = "autopilot_error_rad"
    both = counted & ~np.isnan(errors_of(trace, 0, name))
    return error_summary(trace, both, np.ones_like(both), name)


def _window_s(trace: VehicleTrace) -> tuple[float, float] | msgspec.UnsetType:
    if trace.log_zero_us is None:
        return msgspec.UNSET
    first_s, last_s = (1e-6 * (trace["time_us"][[0, -1]] - trace.log_zero_us)).tolist()
    return first_s, last_s


def sort_counts(counts: Mapping[str, int]) -> dict[str, int]:
    """Counts by name, so that equal runs print equal text."""
    return {name: counts[name] for name in sorted(counts)}


def verdicts(trace: VehicleTrace) -> dict[str, int]:
    """How many looks at both attitudes have ended with which word."""
    return sort_counts({word.value: n for word, n in trace.second_opinion.looks.items()})


def differences_of(trace: VehicleTrace) -> list[DifferenceSummary]:
    """When the autopilot's attitude differed from ours, in seconds of the log."""
    begun_us = trace.zero_us
    return [
        DifferenceSummary(
            begin_s=round((each.begin_us - begun_us) * 1e-6, 1),
            end_s=round((each.end_us - begun_us) * 1e-6, 1),
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
            time_s=(time_us - begun_us) * 1e-6,
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
    counts = dict(trace.imu_messages.most_common())
    steps_s = 1e-6 * np.diff(trace["time_us"])
    are_some = len(steps_s) > 0
    return ImuSummary(
        message=next(iter(counts), ""),
        samples=len(trace),
        messages=counts,
        median_rate_hz=1.0 / float(np.median(steps_s)) if are_some else None,
        mean_rate_hz=1.0 / float(np.mean(steps_s)) if are_some else None,
        worst_gap_s=float(steps_s.max()) if are_some else None,
        worst_arrival_gap_s=1e-6 * float(np.diff(trace["arrival_us"]).max()) if are_some else None,
        rates=trace.rates,
    )
