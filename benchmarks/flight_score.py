"""Scores of a replay: its errors, and whether sigma covers them, in every stretch, too."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.events import Event
from estimator.profile import load_profile, merge_profile
from fuzzbee.replays.comparison import compare
from fuzzbee.replays.trace import Replay

Floats = NDArray[np.float64]
STRETCH_S = 20.0


class Score(NamedTuple):
    """Degrees RMS, and shares of the errors under sigma: of all, and of the worst stretch."""

    total: float
    heading: float
    inclination: float
    covered_inclination: float
    covered_heading: float
    worst_inclination: float
    worst_heading: float
    accelerometer: float  # inclination by the accelerometer alone, degrees RMS


def score(
    events: Iterable[Event], *, skip_s: float, profile: dict[str, Any] | None = None
) -> Score:
    """Replay the events through the service's pipeline, against the simulator's truth."""
    replay = Replay(merge_profile(load_profile("imu"), profile or {}))
    replay.run(events)
    trace = max(replay.traces.values(), key=lambda each: len(each.attitudes))
    compared = compare(Path("events"), trace, "sim")
    time_s = 1e-6 * (trace.times_us - trace.times_us[0])
    counted = compared.known & (time_s >= skip_s)
    if not counted.any():
        sys.exit(f"no sample with a truth after {skip_s:g} s: the flight is too short")
    errors = np.degrees(compared.errors_rad[counted])
    covered = [
        errors[:, 2] <= np.degrees(trace.column(lambda a: a.sigma_inclination_rad))[counted],
        errors[:, 1] <= np.degrees(trace.column(lambda a: a.sigma_heading_rad))[counted],
    ]
    rms = np.sqrt(np.mean(errors**2, axis=0))
    shares = [float(np.mean(c)) for c in covered]
    worst = [worst_stretch(time_s[counted], c) for c in covered]
    force = np.array([sample.acc_m_s2 for sample in trace.samples])[counted]
    alone = accelerometer_rms_deg(force, compared.truth[counted])
    return Score(float(rms[0]), float(rms[1]), float(rms[2]), *shares, *worst, alone)


def accelerometer_rms_deg(force: Floats, truth: Floats) -> float:
    """RMS angle between minus the force (N, 3) and the true down of q_ned_frd (N, 4)."""
    w, x, y, z = truth.T
    down = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
    up = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-6)
    angles = np.arccos(np.clip(-np.sum(up * down, axis=1), -1.0, 1.0))
    return float(np.degrees(np.sqrt(np.mean(angles**2))))


def worst_stretch(time_s: Floats, covered: NDArray[np.bool_]) -> float:
    """The least share in any ``STRETCH_S``, begun at whole seconds."""
    shares = []
    for begin in np.arange(time_s[0], max(time_s[-1] - STRETCH_S, time_s[0]) + 1e-6, 1.0):
        first, last = np.searchsorted(time_s, (begin, begin + STRETCH_S))
        shares.append(float(np.mean(covered[first:last])))
    return min(shares)


def line(name: str, of: Score) -> str:
    """A row of text."""
    return (
        f"{name:34s} total {of.total:6.2f} heading {of.heading:6.2f} inclination "
        f"{of.inclination:6.2f} under sigma {of.covered_inclination:.2f} {of.covered_heading:.2f} "
        f"worst 20 s {of.worst_inclination:.2f} {of.worst_heading:.2f} "
        f"accelerometer {of.accelerometer:.2f}"
    )
