"""One log replayed and scored: the figures of ``replay LOG``."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from drivers.logs.open import open_log
from drivers.logs.reference_track import attitudes_at
from estimator.errors import InputError
from estimator.geometry.metrics import batch_angle_errors
from estimator.profile import Profile
from fuzzbee.replays.report import LogReport
from fuzzbee.replays.score import compare, convergence_s, score
from fuzzbee.replays.trace import AS_LIVE, How, Replay, VehicleTrace, smooth

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
    exports: Sequence[Export] = (),
) -> LogReport:
    """Replay a log and score it; ``exports`` are given the compared trace."""
    started = time.perf_counter()
    name = path.name if profile_name is None else f"{path.name} with {profile_name}"
    named = how._replace(notify=lambda text: how.notify(f"{name}: {text}"))
    trace = replay_log(path, profile, named)
    compare(path, trace, reference)
    report = score(path, trace, skip_s)
    if how.start_wrong_deg:
        quiet = how._replace(notify=AS_LIVE.notify, system_id=trace.address.system_id)
        right = replay_log(path, profile, quiet._replace(start_wrong_deg=0.0))
        # When nothing is left of a wrong start, beside the attitude without it: beside the truth
        # it would count what is learnt of the declination or the vertical meanwhile. Another IMU
        # may stand in after a turn: at other times.
        since = int(np.searchsorted(trace["time_us"], trace.turned_at_us or 0))
        times_us, q = trace["time_us"][since:], trace["q_ned_frd"][since:]
        beside = attitudes_at(times_us, right["time_us"], right["q_ned_frd"])
        forgotten_s = convergence_s(times_us, batch_angle_errors(q, beside)[:, 0])
        report = replace(report, convergence_s=forgotten_s)
    for write in exports:
        write(trace)
    took_s = time.perf_counter() - started
    return replace(report, wall_s=took_s, profile=profile_name or msgspec.UNSET)


def replay_log(path: Path, profile: Profile, how: How = AS_LIVE) -> VehicleTrace:
    """The trace of one vehicle."""
    replay = Replay(profile, how)
    with open_log(path, how.columns) as log, how.reading(log):
        replay.run(log)
    trace = replay.longest()
    if trace is None:
        whose = "" if how.system_id is None else f" of system id {how.system_id}"
        none = f"no IMU data{whose} that can be used{_seen_text(replay)}"
        raise InputError(f"{path}: {replay.why_empty or log.advice(how.system_id) or none}")
    if (refused := refused_text(trace)) is not None:
        how.notify(refused)
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
