"""What sets the gain, on real IMUs: the profile imu with other gains, a row each.

python benchmarks/broad_gains.py DIR [--json] [--kick]

DIR as for ``broad.py``. Errors are RMS degrees in BROAD's protocol; ``change`` is the mean change
of the total against the shipped gain by trial, with its bootstrapped 95 % interval. Coverage is the
share of errors under the published sigma, at rest and in motion, of the live estimator on block
means at 50 Hz. ``--kick``: seconds until the total error is first under 5 degrees after an
unsensed turn of 179, 60, 30 or 20 degrees, at rest (t = 15 s) and in motion (t = 70 s).
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from broad import kicks, score_run, summary
from broad_ablation import interval
from broad_data import Trial, crop, decimate, load_trials
from broad_fuzzbee import ENU_SENSOR_OF_NED_FRD, FuzzbeeFilter, sample_of
from broad_scores import errors_deg

from estimator.estimator import Estimator
from estimator.profile import Profile, load_profile, merge_profile

GAINS: dict[str, dict[str, Any]] = {
    "shipped": {},
    "fuzzy": {"gain": "fuzzy"},
    "K = 1": {"gain": "fixed", "fixed_gain": 1.0},
    "K = 5": {"gain": "fixed", "fixed_gain": 5.0},
    "K = 20": {"gain": "fixed", "fixed_gain": 20.0},
    "K = 50": {"gain": "fixed", "fixed_gain": 50.0},
    "K = 200": {"gain": "fixed", "fixed_gain": 200.0},
    "noise": {"gain": "noise"},
}
COVERAGE_RATE_HZ = 50.0
KICKS_DEG = (179.0, 60.0, 30.0, 20.0)
KICK_TIMES_S = {"rest": 15.0, "motion": 70.0}


def inside_sigma(trial: Trial, profile: Profile) -> np.ndarray:
    """Whether inclination and heading are inside sigma, (N, 2); NaN without a truth."""
    estimator = Estimator(profile)
    estimates, sigmas = [], []
    for k in range(len(trial.gyr_rad_s)):
        sample = sample_of(trial, k)
        estimator.update(sample)
        published = estimator.attitude(sample.time_us)
        estimates.append(published.q_ned_frd)
        sigmas.append((published.sigma_inclination_rad, published.sigma_heading_rad))
    q = np.array(estimates) @ ENU_SENSOR_OF_NED_FRD
    _, heading, inclination = errors_deg(q, trial.q_enu_sensor)
    errors = np.stack([inclination, heading], axis=1)
    return np.where(np.isnan(errors), np.nan, errors <= np.degrees(sigmas))


def coverage(trials: Sequence[Trial], profile: Profile) -> dict[str, float]:
    """Shares inside sigma over all trials."""
    profile = merge_profile(profile, {"conditioning": {"averaged_samples": True}})
    slow = [decimate(trial, COVERAGE_RATE_HZ) for trial in trials]
    inside = np.concatenate([inside_sigma(trial, profile) for trial in slow])
    moving = np.concatenate([trial.moving for trial in slow])
    return {
        f"{part}_{name}": float(np.nanmean(inside[rows, i]))
        for name, rows in (("rest", ~moving), ("motion", moving))
        for i, part in enumerate(("inclination", "heading"))
    }


def measure(folder: Path, *, kick: bool) -> dict[str, Any]:
    """One entry a gain."""
    trials = load_trials(folder)
    short = [crop(t) for t in trials]
    rows: dict[str, Any] = {}
    for name, change in GAINS.items():
        print(f"{name} ...", file=sys.stderr, flush=True)
        profile = merge_profile(load_profile("imu"), {"filter": change})
        f = FuzzbeeFilter(name, profile)
        entry = summary(trials, [score_run(f, t) for t in trials])
        entry["cropped_rms_deg"] = summary(short, [score_run(f, t) for t in short])["total_rms_deg"]
        entry["coverage"] = coverage(trials, profile)
        if kick:
            entry["kick_s"] = {
                f"{angle:g} {where}": kicks(f, trials, angle, time_s)
                for angle in KICKS_DEG
                for where, time_s in KICK_TIMES_S.items()
            }
        rows[name] = entry
    base = np.array(list(rows["shipped"]["per_trial"].values()))
    for entry in rows.values():
        entry["change"] = interval(np.array(list(entry["per_trial"].values())) - base)
    return {"trials": len(trials), "gains": rows}


def show(result: dict[str, Any]) -> None:
    """A line a gain, and one for each turn."""
    for name, row in result["gains"].items():
        change, low, high = row["change"]
        inside = ", ".join(f"{part} {share:.2f}" for part, share in row["coverage"].items())
        print(
            f"{name:8s} total {row['total_rms_deg']:.4f}  heading {row['heading_rms_deg']:.4f}  "
            f"inclination {row['inclination_rms_deg']:.4f}  cropped {row['cropped_rms_deg']:.4f}  "
            f"change {change:+.4f} [{low:+.4f}, {high:+.4f}]  inside sigma: {inside}"
        )
        for turn, axes in row.get("kick_s", {}).items():
            text = "  ".join(
                f"{axis} {_seconds(found['median'])} ({_seconds(found['worst'])})"
                for axis, found in axes.items()
            )
            print(f"    {turn:10s} {text}")


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f}"


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--kick", action="store_true", help="recovery from unsensed turns")
    args = parser.parse_args(argv)
    result = measure(args.folder, kick=args.kick)
    if args.json:
        print(json.dumps(result))
    else:
        show(result)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
