"""What each conditioning step is worth on BROAD: all steps, then all but one at a time.

python benchmarks/broad_ablation.py DIR [--json]

The other settings stay the same; ``difference`` is the mean change of the
total by trial with its bootstrapped 95 % interval, full trials.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from broad import kicks, score_run, summary
from broad_data import Array, crop, load_trials
from broad_fuzzbee import FuzzbeeFilter

STEPS = (
    "use_gravity_filter",
    "use_rest",
    "use_motion_bias",
    "use_averaging",
    "use_scale_error",
    "use_joint_covariance",
    "use_lag",
    "use_field_offset",
    "use_confidence",
    "use_events",
    "use_step_noise",
)
KICK_DEG = 179.0
KICK_TIME_S = 15.0
BOOTSTRAP_DRAWS = 10_000


def interval(differences: Array) -> tuple[float, float, float]:
    """Mean, and 95 % of the means of trials drawn with replacement."""
    draws = np.random.default_rng(0).choice(differences, (BOOTSTRAP_DRAWS, len(differences)))
    low, high = np.percentile(draws.mean(axis=1), [2.5, 97.5])
    return float(differences.mean()), float(low), float(high)


def ablation(folder: Path) -> dict[str, Any]:
    """One entry a step switched off, and one with all of them."""
    trials = load_trials(folder)
    short = [crop(t) for t in trials]
    rows: dict[str, Any] = {}
    for step in ("", *STEPS):
        f = FuzzbeeFilter("fuzzbee", "imu", **({step: False} if step else {}))
        entry = summary(trials, [score_run(f, t) for t in trials])
        entry["cropped_rms_deg"] = summary(short, [score_run(f, t) for t in short])["total_rms_deg"]
        entry["kick_s"] = kicks(f, trials, KICK_DEG, KICK_TIME_S)
        rows[step.removeprefix("use_") + "_off" if step else "all"] = entry
    base = np.array(list(rows["all"]["per_trial"].values()))
    for entry in rows.values():
        entry["difference"] = interval(np.array(list(entry["per_trial"].values())) - base)
    return {"trials": len(trials), "steps": rows}


def main(argv: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    result = ablation(args.folder)
    if args.json:
        print(json.dumps(result))
        return 0
    for name, row in result["steps"].items():
        change, low, high = row["difference"]
        worst = [axis["worst"] for axis in row["kick_s"].values()]
        print(
            f"{name:22s} total {row['total_rms_deg']:5.2f}  heading {row['heading_rms_deg']:5.2f}  "
            f"inclination {row['inclination_rms_deg']:5.2f}  change {change:+5.2f} "
            f"[{low:+.2f}, {high:+.2f}]  cropped {row['cropped_rms_deg']:5.2f}  "
            f"kick worst {', '.join('never' if w is None else f'{w:.1f}' for w in worst)} s"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
