"""A flight's events, changed or not, through the live pipeline, and their scores."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common.recordings import Array, Bools
from common.report import DATA, Row
from common.scores import rms
from msgspec.structs import replace

from drivers.events import Event, Imu
from drivers.logs.open import open_log
from estimator.geometry.rotations import rotate_inverse
from estimator.profile import load_profile, merge_profile
from estimator.types import DOWN, ImuSample
from fuzzbee.replays.score import compare
from fuzzbee.replays.trace import Replay, VehicleTrace

Events = list[Event]
SHORT_LOG = DATA / "sitl_copter_flips.tlog"
UNAIDED = {"aiding": {"enabled": False}}
STRETCH_S = 20.0


class Flown(NamedTuple):
    """A replay beside the truth; rows are samples, errors total, heading, inclination, degrees."""

    trace: VehicleTrace
    time_s: Array
    truth: Array
    errors_deg: Array
    sigma_deg: Array  # (N, 2) inclination, heading


def read(path: Path) -> Events:
    """All events of a log."""
    with open_log(path) as log:
        return list(log)


def changed(events: Events, change: Callable[[ImuSample], ImuSample]) -> Events:
    """The events with other IMU samples."""
    return [
        replace(event, sample=change(event.sample)) if isinstance(event, Imu) else event
        for event in events
    ]


def fly(events: Iterable[Event], changes: dict[str, Any] | None = None) -> Flown:
    """Replay the events as the service would, with changes of the profile ``imu``."""
    replay = Replay(merge_profile(load_profile("imu"), changes or {}))
    replay.run(events)
    trace = max(replay.traces.values(), key=len)
    compare(trace, "sim")
    truth, errors = trace["reference_q_ned_frd"], trace["error_rad"]
    sigma = [trace[f"sigma_{angle}_rad"] for angle in ("inclination", "heading")]
    return Flown(
        trace,
        1e-6 * (trace["time_us"] - trace["time_us"][0]),
        truth,
        np.degrees(errors),
        np.degrees(np.stack(sigma, axis=-1)),
    )


def score(flown: Flown, skip_s: float) -> Row:
    """Degrees RMS, shares of the errors under sigma: of all, and of the worst stretch.

    ``accelerometer`` is the inclination by the accelerometer alone.

    Raises:
        SystemExit: the flight is shorter than what is left out.
    """
    counted = np.isfinite(flown.truth[:, 0]) & (flown.time_s >= skip_s)
    if not counted.any():
        raise SystemExit(f"no sample with a truth after {skip_s:g} s: the flight is too short")
    errors = flown.errors_deg[counted]
    total, heading, inclination = rms(errors)
    covered = errors[:, [2, 1]] <= flown.sigma_deg[counted]
    force = flown.trace["acc_m_s2"][counted]
    return {
        "total": total,
        "heading": heading,
        "inclination": inclination,
        "under sigma": np.mean(covered, axis=0).tolist(),
        "worst 20 s": worst_stretch(flown.time_s[counted], covered),
        "accelerometer": rms(tilt_deg(-force, rotate_inverse(flown.truth[counted], DOWN))),
    }


def worst_stretch(time_s: Array, covered: Bools) -> list[float]:
    """The least share of each column in any ``STRETCH_S``, begun at whole seconds."""
    shares = []
    for begin in np.arange(time_s[0], max(time_s[-1] - STRETCH_S, time_s[0]) + 1e-6, 1.0):
        first, last = np.searchsorted(time_s, (begin, begin + STRETCH_S))
        shares.append(np.mean(covered[first:last], axis=0))
    least: list[float] = np.min(shares, axis=0).tolist()
    return least


def tilt_deg(some: Array, others: Array) -> Array:
    """Angles between vectors (N, 3)."""
    sine = np.linalg.norm(np.cross(some, others), axis=1)
    return np.degrees(np.arctan2(sine, np.sum(some * others, axis=1)))
