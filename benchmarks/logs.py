"""How far is the inclination off on recorded logs, beside what plain filters do?

    python benchmarks/logs.py DIR|LOG...

Every log goes through the same reading and pipeline as ``fuzzbee replay``. The plain filters see
the same samples: the accelerometer alone, and complementary filters of several time constants, of
which the best is chosen in hindsight, log by log. ``mean of force`` is that of the last 10 s in the
body. All are compared with the simulator's truth where the log has it, else with the autopilot's
own attitude, less one constant rotation, since IMU and autopilot may be mounted apart. Degrees RMS;
the share of errors under sigma in motion and at rest. Then medians by motion and rate.
"""

from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median

import numpy as np
from common.recordings import Array, Bools
from common.report import DATA, Row, Tables, benchmark, each_log, log_files, option
from common.scores import by, mean_of, rms
from flying.replayed import tilt_deg
from scipy.spatial.transform import Rotation

from estimator.geometry.rotations import rotate_inverse
from estimator.profile import load_profile
from estimator.types import DOWN
from fuzzbee.replays.motion import motion_mask
from fuzzbee.replays.score import compare
from fuzzbee.replays.trace import VehicleTrace, replay_log

MEAN_S = 10.0
TAUS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
RATE_EDGES_HZ = (2.2, 3.3, 5.0, 25.0)
LEAST_COMPARED = 20  # samples
# The share of samples in motion from which a log counts as one of a moving vehicle.
LEAST_MOVING_SHARE = 0.1


def complementary(gyr: Array, up: Array, dt_s: Array, tau_s: float) -> Array:
    """Down (N, 3) turned by the gyroscope and pulled to the accelerometer's with ``tau_s``.

    d <- exp(-[w]x dt) d, then d <- d + (1 - exp(-dt/tau)) (-up - d). The rate is the mean of both
    ends of the step.
    """
    rate = gyr.copy()
    rate[1:] = 0.5 * (gyr[1:] + gyr[:-1])
    turns = Rotation.from_rotvec(-rate * dt_s[:, None]).as_matrix()
    pulls = 1.0 - np.exp(-dt_s / tau_s)
    down, d = np.empty_like(up), -up[0]
    for k, (turn, pull) in enumerate(zip(turns, pulls, strict=True)):
        d = turn @ d
        d += pull * (-up[k] - d)
        d /= np.sqrt(d @ d) + 1e-12
        down[k] = d
    return down


def mean_force(acc: Array, dt_s: Array) -> Array:
    """Down (N, 3) where minus the mean force of the last ``MEAN_S`` points, seen from the body."""
    down, mean, age_s = np.empty_like(acc), np.zeros(3), 0.0
    for k, (force, step_s) in enumerate(zip(acc, np.maximum(dt_s, 1e-6), strict=True)):
        age_s = min(age_s + step_s, MEAN_S)
        mean += min(1.0, step_s / age_s) * (force - mean)
        down[k] = -mean / (np.sqrt(mean @ mean) + 1e-12)
    return down


def plain_filters(trace: VehicleTrace) -> dict[str, Array]:
    """Down (N, 3) by the accelerometer alone and by complementary filters."""
    gyr, acc = trace["gyr_rad_s"], trace["acc_m_s2"]
    up = acc / np.maximum(np.linalg.norm(acc, axis=1, keepdims=True), 1e-6)
    dt = np.diff(trace["time_us"], prepend=trace["time_us"][0]) * 1e-6
    filters = {f"complementary {tau:g} s": complementary(gyr, up, dt, tau) for tau in TAUS_S}
    return {"accelerometer": -up, **filters}


def errors_deg(down: Array, reference: Array) -> Array:
    """Angles (N,) between two downs once one constant rotation is taken off (Wahba)."""
    return tilt_deg(Rotation.align_vectors(reference, down)[0].apply(down), reference)


def share(under: Bools, which: Bools) -> float | None:
    """Share of the chosen samples that are under sigma; None if the chosen are too few."""
    return float(np.mean(under[which])) if np.count_nonzero(which) >= LEAST_COMPARED else None


def score(path: Path, trace: VehicleTrace) -> Row | None:
    """The figures of one log; None if there is too little to compare with."""
    compare(trace, None)
    source, truth = trace.reference, trace["reference_q_ned_frd"]
    known = np.isfinite(truth[:, 0])
    if source is None or np.count_nonzero(known) < LEAST_COMPARED:
        return None
    steps_s = np.diff(trace["time_us"], append=trace["time_us"][-1]) * 1e-6
    downs = rotate_inverse(truth[known], DOWN)
    moving = motion_mask(trace)[known]
    ours = errors_deg(rotate_inverse(trace["q_ned_frd"][known], DOWN), downs)
    others = {
        name: rms(errors_deg(down[known], downs)) for name, down in plain_filters(trace).items()
    }
    sigma = np.degrees(trace["sigma_inclination_rad"])[known]
    by_mean = mean_force(trace["acc_m_s2"], np.roll(steps_s, 1))
    best = min(others, key=lambda name: others[name])
    return {
        "log": path.name,
        "against": source,
        "Hz": float(1.0 / np.median(steps_s[:-1])),
        "s": round(float(steps_s.sum())),
        "moving": float(np.mean(moving)),
        "fuzzbee": rms(ours),
        "accelerometer": others["accelerometer"],
        "mean of force": rms(errors_deg(by_mean[known], downs)),
        "best": others[best],
        "which": best,
        "under sigma moving": share(ours <= sigma, moving),
        "at rest": share(ours <= sigma, ~moving),
        "sigma": float(np.median(sigma)),
    }


def rate_group(rate_hz: float) -> str:
    """The name of the group that a rate belongs to."""
    edges = ["", *(f"{edge:g}" for edge in RATE_EDGES_HZ), ""]
    k = sum(rate_hz >= edge for edge in RATE_EDGES_HZ)
    return f"{edges[k]}-{edges[k + 1]}"


def group(logs: Sequence[Row]) -> Row:
    """Medians over the logs of a group."""
    columns = ("fuzzbee", "accelerometer", "mean of force", "best", "under sigma moving", "at rest")
    medians = mean_of([{name: log[name] for name in columns} for log in logs], median)
    worst = max(log["fuzzbee"] / max(log["accelerometer"], 1e-9) for log in logs)
    return {"logs": len(logs), **medians, "worst over the accelerometer": worst}


def groups(logs: Sequence[Row]) -> Iterator[Row]:
    """By motion and rate."""
    for moving in (True, False):
        chosen = sorted(
            (log for log in logs if (log["moving"] >= LEAST_MOVING_SHARE) is moving),
            key=lambda log: log["Hz"],
        )
        for name, those in by(chosen, lambda log: rate_group(log["Hz"])).items():
            yield {"": "moving" if moving else "at rest", "Hz": name, **group(those)}


@benchmark(
    option("folders", nargs="*", type=Path, metavar="DIR|LOG"),
    option("--profile", default="imu", help="imu or a TOML file [default: imu]"),
)
def main(options: Namespace) -> Tables:
    if options.smoke:
        options.folders = options.folders or [DATA / "sub_bluerov.tlog", DATA / "px4_hover.ulg"]
    profile = load_profile(options.profile)
    traces = each_log(log_files(options.folders), lambda path: replay_log(path, profile))
    logs = [row for path, trace in traces if (row := score(path, trace))]
    if not logs:
        raise SystemExit("give logs with a reference or folders of them, or --smoke")
    return {"logs, degrees": logs, "medians": [*groups(logs)]}
