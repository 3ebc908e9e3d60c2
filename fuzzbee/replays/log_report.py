"""One log replayed and scored: the figures of ``replay LOG``."""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import replace

from drivers.logs.log_file import LogFile
from drivers.logs.open import open_log
from drivers.logs.reference_track import attitudes_at
from drivers.mavlink.constants import enum_name
from estimator.errors import InputError
from estimator.estimator import Estimator
from estimator.geometry.metrics import batch_angle_errors
from estimator.live.rows import NORTHS
from estimator.profile import Profile
from fuzzbee.attitudes import PLACE
from fuzzbee.notify import printable
from fuzzbee.replays.motion import motion_mask
from fuzzbee.replays.score import (
    DifferenceSummary,
    ImuSummary,
    LogReport,
    RetunedSummary,
    Retuning,
    VehicleSummary,
    compare,
    constant_turn,
    convergence_s,
    coverage,
    error_summary,
)
from fuzzbee.replays.trace import AS_LIVE, How, Replay, VehicleTrace, smooth
from tuning.online.retuner import RetunedEstimator

Reading = Callable[[LogFile], AbstractContextManager[object]]
Export = Callable[[VehicleTrace], None]

MUCH_REFUSED = 0.1  # of all readings: a line is printed
MOST_REASONS = 3  # that it names


def report_log(
    path: Path,
    profile: Profile,
    how: How = AS_LIVE,
    *,
    reference: str | None = None,
    skip_s: float = 0.0,
    profile_name: str | None = None,
    notify: Callable[[str], None] = lambda _: None,
    reading: Reading = nullcontext,
    exports: Sequence[Export] = (),
) -> LogReport:
    """Replay a log and score it; ``exports`` are given the compared trace."""
    started = time.perf_counter()
    name = path.name if profile_name is None else f"{path.name} with {profile_name}"
    trace = replay_log(path, profile, how, lambda text: notify(f"{name}: {text}"), reading)
    compare(path, trace, reference)
    report = score(path, trace, skip_s)
    if how.start_wrong_deg:
        rightly = how._replace(start_wrong_deg=0.0, system_id=trace.address.system_id)
        right = replay_log(path, profile, rightly, reading=reading)
        report = replace(report, convergence_s=_forgotten_s(trace, right))
    for write in exports:
        write(trace)
    took_s = time.perf_counter() - started
    return replace(report, wall_s=took_s, profile=profile_name or msgspec.UNSET)


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
    how: How = AS_LIVE,
    notify: Callable[[str], None] = lambda _: None,
    reading: Reading = nullcontext,
    new_estimator: Callable[[Profile], Estimator] | None = None,
) -> VehicleTrace:
    """The trace of one vehicle; ``reading`` is entered with the log while it is read."""
    replay = Replay(profile, how, notify=notify, new_estimator=new_estimator)
    with open_log(path, how.columns) as log, reading(log):
        replay.run(log)
    trace = replay.longest()
    if trace is None:
        whose = "" if how.system_id is None else f" of system id {how.system_id}"
        none = f"no IMU data{whose} that can be used{_seen_text(replay)}"
        raise InputError(f"{path}: {replay.why_empty or log.advice(how.system_id) or none}")
    if (refused := refused_text(trace)) is not None:
        notify(refused)
    if how.smooth:
        smooth(trace)
    return trace


def refused_text(trace: VehicleTrace) -> str | None:
    """One line, where a good part of the log was refused."""
    counts, used = trace.rejected, len(trace)
    if counts.total() <= MUCH_REFUSED * (counts.total() + used):
        return None
    reasons = ", ".join(f"{n} x {reason}" for reason, n in counts.most_common(MOST_REASONS))
    return f"much was refused: {reasons}; {used} samples were used"


def _seen_text(replay: Replay) -> str:
    """What the log has instead of usable IMU data, for the error message."""
    pipeline = replay.pipeline
    refused = sum((each.rejected for each in pipeline.vehicles), start=Counter[str]())
    if refused:
        return ": " + ", ".join(f"{n} x {reason}" for reason, n in sorted(refused.items()))
    if ids := sorted(pipeline.systems | {address.system_id for address in replay.traces}):
        return f" (vehicles seen: {', '.join(map(str, ids))})"
    return f": {pipeline.malformed} x malformed" if pipeline.malformed else ""


def score(path: Path, trace: VehicleTrace, skip_s: float) -> LogReport:
    """The figures of a trace that has been compared."""
    times_us, norths = trace["time_us"], trace["heading_reference"]
    begin_s, end_s = trace.time_s[[0, -1]].tolist()
    lasts_s = 1e-6 * float(times_us[-1] - times_us[0])
    total_rad = trace["error_rad"][:, 0].copy()  # not a view, that the column is let go
    counted = ~np.isnan(total_rad)
    counted[: int(np.searchsorted(times_us, times_us[0] + 1e6 * skip_s))] = False
    if skip_s > 0.0 and not counted.any():
        raise InputError(f"{path}: nothing is left to score after {skip_s:g} s of {lasts_s:.0f} s")
    moved = motion_mask(trace) if counted.any() else counted
    has_heading = norths > PLACE["none"]
    peers = {}
    if trace.has_peer:  # which all has a heading
        theirs = trace["autopilot_error_rad"]
        both = counted & ~np.isnan(theirs[:, 0])
        peers["autopilot"] = error_summary(theirs, both, both)
    kinds = zip(("MAV_AUTOPILOT", "MAV_TYPE"), trace.kind, strict=True)
    names = (None if number is None else enum_name(enum, number) for enum, number in kinds)
    counts = np.bincount(norths[counted], minlength=len(NORTHS)).tolist()
    return LogReport(
        source=printable(str(path)),
        vehicle=VehicleSummary(*trace.address, *names),
        imu=_imu_summary(trace),
        duration_s=lasts_s,
        reference=trace.reference,
        error_deg=error_summary(trace["error_rad"], counted, has_heading),
        coverage=coverage(trace, counted, has_heading, moved),
        peers=peers,
        convergence_s=convergence_s(times_us, total_rad) if trace.has_heading else None,
        mean_gain=float(np.mean(trace["gain"])),
        rejected=by_name(trace.rejected),
        wall_s=0.0,
        heading_references=by_name({k: n for k, n in zip(NORTHS, counts, strict=True) if n}),
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


def differences_of(trace: VehicleTrace) -> list[DifferenceSummary]:
    """When the autopilot's attitude differed from ours, in seconds of the log."""
    return [
        DifferenceSummary(
            begin_s=round((each.begin_us - trace.zero_us) * 1e-6, 1),
            end_s=round((each.end_us - trace.zero_us) * 1e-6, 1),
            inclination_deg=round(each.inclination_deg, 1),
            heading_deg=round(each.heading_deg, 1),
            wrong=each.wrong,
            evidence=each.evidence,
        )
        for each in trace.vehicle.comparison.intervals
    ]


def _retuned(trace: VehicleTrace) -> RetunedSummary | msgspec.UnsetType:
    """What was changed with ``--retune``."""
    estimator = trace.vehicle.estimator
    if not isinstance(estimator, RetunedEstimator):
        return msgspec.UNSET
    changes = [
        Retuning((time_us - trace.zero_us) * 1e-6, made.reason, made.gain, made.update)
        for time_us, made in estimator.decisions
    ]
    return RetunedSummary(len(changes), changes)


def _imu_summary(trace: VehicleTrace) -> ImuSummary:
    counts = dict(trace.imu_messages.most_common())
    steps_s, gaps_s = (1e-6 * np.diff(trace[name]) for name in ("time_us", "arrival_us"))
    figures: tuple[Any, Any, Any, Any] = (None, None, None, None)
    if len(steps_s):
        rates_hz = 1.0 / float(np.median(steps_s)), 1.0 / float(np.mean(steps_s))
        figures = (*rates_hz, float(steps_s.max()), float(gaps_s.max()))
    rates = trace.vehicle.estimator.rates
    return ImuSummary(next(iter(counts), ""), len(trace), counts, *figures, rates)
