"""Inclination on recorded logs beside what plain rivals do, by rate and motion.

Every log of the folders goes through the same reading and the same pipeline as
``fuzzbee replay``. The rivals see the same samples: the accelerometer alone
and complementary filters of several time constants. The best of them is
chosen in hindsight, log by log: a filter tuned on the answer. All are compared
with the simulator's truth where the log has it, else with the autopilot's own
attitude, which is no truth. From each one constant rotation is taken off, since
IMU and autopilot may be mounted apart.

example: python benchmarks/real_logs.py logs logs/more --json
"""

import argparse
import json
import statistics
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from estimator.compilation.compiled import compiled
from estimator.errors import InputError
from estimator.geometry.metrics import rms
from estimator.profile import Profile, load_profile
from fuzzbee.replays.comparison import compare
from fuzzbee.replays.log_report import replay_log
from fuzzbee.replays.motion import motion_mask
from fuzzbee.replays.trace import VehicleTrace

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SUFFIXES = (".tlog", ".log", ".bin", ".ulg")
COMPLEMENTARY_TAUS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
RATE_EDGES_HZ = (2.2, 3.3, 5.0, 25.0)
FAR_DEG = 30.0  # no estimate should be this far off while the vehicle is less than that from level
LEAST_COMPARED = 20  # samples
# The share of samples in motion from which a log counts as one of a moving vehicle.
LEAST_MOVING_SHARE = 0.1


class Log(NamedTuple):
    """What every estimate of a log is scored on; rows are samples that a reference is known at."""

    reference: str
    downs: Floats  # the reference's down in FRD
    steps_s: Floats  # until the next sample, at most 1 s
    moving: Bools


class Rival(NamedTuple):
    """Down in FRD (N, 3) by one of the estimates."""

    name: str
    down: Floats


def down_in_body(q_ned_frd: Floats) -> Floats:
    """(N, 3): the third row of the rotation matrix of each (N, 4) quaternion."""
    w, x, y, z = q_ned_frd.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)


@compiled
def complementary(gyr: Floats, acc: Floats, dt_s: Floats, tau_s: float) -> Floats:
    """Down (N, 3) turned by the gyroscope and pulled to the accelerometer's with ``tau_s``.

    d <- exp(-[w]x dt) d, then d <- d + (1 - exp(-dt/tau)) (u - d) with u the
    accelerometer's direction. The rate is the mean of both ends of the step.
    """
    down = np.empty(gyr.shape)
    d = -acc[0] / np.sqrt(np.sum(acc[0] ** 2) + 1e-12)
    for k in range(len(gyr)):
        u = -acc[k] / np.sqrt(np.sum(acc[k] ** 2) + 1e-12)
        if k > 0:
            phi = -0.5 * (gyr[k] + gyr[k - 1]) * dt_s[k]
            angle = np.sqrt(np.sum(phi**2))
            if angle > 0.0:
                n = phi / angle
                d = (
                    d * np.cos(angle)
                    + np.cross(n, d) * np.sin(angle)
                    + n * np.sum(n * d) * (1.0 - np.cos(angle))
                )
        d = d + (1.0 - np.exp(-dt_s[k] / tau_s)) * (u - d)
        d = d / np.sqrt(np.sum(d**2) + 1e-12)
        down[k] = d
    return down


def rivals(trace: VehicleTrace) -> list[Rival]:
    """The accelerometer alone and the complementary filters."""
    gyr = np.array([sample.gyr_rad_s for sample in trace.samples])
    acc = np.array([sample.acc_m_s2 for sample in trace.samples])
    dt = np.diff(trace.times_us, prepend=trace.times_us[0]) * 1e-6
    alone = -acc / np.maximum(np.linalg.norm(acc, axis=1, keepdims=True), 1e-6)
    filters = [
        Rival(f"complementary {tau:g} s", complementary(gyr, acc, dt, tau))
        for tau in COMPLEMENTARY_TAUS_S
    ]
    return [Rival("accelerometer", alone), *filters]


def inclination_errors(down: Floats, reference: Floats) -> Floats:
    """Angles (N,), deg, between two downs once one constant rotation is taken off (Wahba, SVD)."""
    u, _, vt = np.linalg.svd(down.T @ reference)
    flip = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    aligned = down @ (u @ flip @ vt)
    sine = np.linalg.norm(np.cross(aligned, reference), axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, np.sum(aligned * reference, axis=1))))


def seconds_far_while_level(log: Log, errors_deg: Floats) -> tuple[float, float]:
    """Seconds over ``FAR_DEG`` off while the reference is that near level: all, and in a row."""
    level = log.downs[:, 2] > np.cos(np.radians(FAR_DEG))
    total = longest = run = 0.0
    for far, step in zip(level & (errors_deg > FAR_DEG), log.steps_s, strict=True):
        run = run + float(step) if far else 0.0
        total += float(step) if far else 0.0
        longest = max(longest, run)
    return total, longest


def share(inside: Bools, which: Bools) -> float | None:
    """Share of the chosen samples that are inside; None if the chosen are too few."""
    return float(np.mean(inside[which])) if np.count_nonzero(which) >= LEAST_COMPARED else None


def score_log(path: Path, trace: VehicleTrace) -> dict[str, Any] | None:
    """The figures of one log; None if there is too little to compare with."""
    source, truth, known, _ = compare(path, trace, None)
    if source is None or np.count_nonzero(known) < LEAST_COMPARED:
        return None
    steps_s = np.diff(trace.times_us, append=trace.times_us[-1]) * 1e-6
    rate_hz = float(1.0 / np.median(steps_s[:-1]))
    log = Log(
        source,
        down_in_body(truth[known]),
        np.minimum(steps_s[known], 1.0),
        motion_mask(trace.samples)[known],
    )
    ours = inclination_errors(down_in_body(trace.estimates)[known], log.downs)
    others = {
        rival.name: rms(inclination_errors(rival.down[known], log.downs)) for rival in rivals(trace)
    }
    sigma = np.degrees(trace.column(lambda a: a.sigma_inclination_rad))[known]
    far_s, far_longest_s = seconds_far_while_level(log, ours)
    best = min(others, key=lambda n: others[n])
    return {
        "log": path.name,
        "type": trace.vehicle_type,
        "reference": source,
        "rate_hz": rate_hz,
        "rate_group": rate_group(rate_hz),
        "duration_s": float(trace.times_us[-1] - trace.times_us[0]) * 1e-6,
        "moving_share": float(np.mean(log.moving)),
        "inclination_rms_deg": {"fuzzbee": rms(ours), **others},
        "best_rival": best,
        "ratio_to_accelerometer": rms(ours) / max(others["accelerometer"], 1e-9),
        "coverage_moving": share(ours <= sigma, log.moving),
        "coverage_rest": share(ours <= sigma, ~log.moving),
        "sigma_median_deg": float(np.median(sigma)),
        "far_s": far_s,
        "far_longest_s": far_longest_s,
    }


def rate_group(rate_hz: float) -> str:
    """The name of the group that a rate belongs to."""
    edges = ["", *(f"{edge:g}" for edge in RATE_EDGES_HZ), ""]
    k = sum(rate_hz >= edge for edge in RATE_EDGES_HZ)
    if k == 0:
        return f"<{edges[1]}"
    return f">={edges[k]}" if k == len(RATE_EDGES_HZ) else f"{edges[k]}-{edges[k + 1]}"


def summary(logs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Medians over the logs of a group; None for a group without logs."""

    def median(value: Callable[[dict[str, Any]], float | None]) -> float | None:
        values = [v for v in map(value, logs) if v is not None]
        return statistics.median(values) if values else None

    return {
        "logs": len(logs),
        "fuzzbee_deg": median(lambda log: log["inclination_rms_deg"]["fuzzbee"]),
        "accelerometer_deg": median(lambda log: log["inclination_rms_deg"]["accelerometer"]),
        "best_rival_deg": median(lambda log: log["inclination_rms_deg"][log["best_rival"]]),
        "worst_ratio_to_accelerometer": max(
            (log["ratio_to_accelerometer"] for log in logs), default=None
        ),
        "coverage_moving": median(lambda log: log["coverage_moving"]),
        "coverage_rest": median(lambda log: log["coverage_rest"]),
        "logs_far_over_2_s": sum(log["far_longest_s"] > 2.0 for log in logs),
    }


def group_logs(logs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Summaries by motion and rate."""
    groups = {}
    for name, wanted in (("moving", True), ("rest", False)):
        chosen = [log for log in logs if (log["moving_share"] >= LEAST_MOVING_SHARE) is wanted]
        names = dict.fromkeys(rate_group(hz) for hz in (0.0, *RATE_EDGES_HZ))
        by_rate = {n: [log for log in chosen if log["rate_group"] == n] for n in names}
        groups[name] = {n: summary(some) for n, some in by_rate.items() if some}
    return groups


def log_files(folders: Iterable[Path]) -> list[Path]:
    """The logs in folders, and files given as such."""
    files: list[Path] = []
    for folder in folders:
        inside = sorted(folder.iterdir()) if folder.is_dir() else [folder]
        files += [path for path in inside if path.suffix in SUFFIXES]
    return files


def measure_log(path: Path, profile: Profile) -> dict[str, Any] | None:
    """One log replayed and scored; None where it holds nothing to compare."""
    try:
        trace = replay_log(
            path, profile, fixed_gain=None, start_wrong_deg=0.0, system_id=None, tell=lambda _: None
        )
    except InputError as error:
        print(error, file=sys.stderr)
        return None
    return score_log(path, trace)


def _number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def print_log(log: dict[str, Any]) -> None:
    """One line."""
    errors = log["inclination_rms_deg"]
    best = log["best_rival"]
    print(
        f"{log['log'][:38]:38s} {log['rate_hz']:6.1f} Hz {log['duration_s']:5.0f} s "
        f"moving {log['moving_share']:.2f}  ours {errors['fuzzbee']:6.2f}  "
        f"accelerometer {errors['accelerometer']:6.2f}  best {errors[best]:6.2f} ({best})  "
        f"inside sigma {_number(log['coverage_moving'])} rest {_number(log['coverage_rest'])}  "
        f"sigma {log['sigma_median_deg']:5.2f}  "
        f"far {log['far_s']:.1f} s, at once {log['far_longest_s']:.1f} s",
        flush=True,
    )


def print_groups(groups: dict[str, Any]) -> None:
    """A line each."""
    for motion, by_rate in groups.items():
        for name, group in by_rate.items():
            print(
                f"{motion:6s} {name:>7s} Hz: {group['logs']:3d} logs, "
                f"ours {_number(group['fuzzbee_deg'])}, "
                f"accelerometer {_number(group['accelerometer_deg'])}, "
                f"best rival {_number(group['best_rival_deg'])}, "
                f"worst ratio {_number(group['worst_ratio_to_accelerometer'])}, "
                f"inside sigma {_number(group['coverage_moving'])} moving, "
                f"{_number(group['coverage_rest'])} at rest, "
                f"far over 2 s: {group['logs_far_over_2_s']}"
            )


def main() -> int:
    """Replay all, print a table or one object."""
    parser = argparse.ArgumentParser(description="Inclination on recorded logs, beside rivals.")
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR")
    parser.add_argument("--profile", default="imu", help="imu or a TOML file [default: imu]")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args()
    profile = load_profile(options.profile)
    logs = []
    for path in log_files(options.folders):
        log = measure_log(path, profile)
        if log is None:
            continue
        logs.append(log)
        if not options.json:
            print_log(log)
    if options.json:
        print(json.dumps({"logs": logs, "groups": group_logs(logs)}))
    else:
        print_groups(group_logs(logs))
    return 0 if logs else 1


if __name__ == "__main__":
    sys.exit(main())
