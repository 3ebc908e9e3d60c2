"""Arrays in, quaternions out: fuzzbee's and vqf's own calls on the same files (BROAD).

    python benchmarks/arrays.py FOLDER

Root mean square of the total error over the scored rows, degrees, and microseconds of processor
time a sample. Both with their defaults; what tuned filters do is in ``broad.py``.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from broad_data import Array, Trial, load_trials
from broad_scores import score
from vqf import VQF

from fuzzbee import Estimator

FRD_OF_SENSOR = np.array([1.0, -1.0, -1.0])
GAUSS_PER_MICRO_TESLA = 0.01
Filter = Callable[[Trial], Array]


def fuzzbee_batch(trial: Trial) -> Array:
    """``q_enu_sensor`` (N, 4) by one call."""
    gyr, acc = trial.gyr_rad_s * FRD_OF_SENSOR, trial.acc_m_s2 * FRD_OF_SENSOR
    mag = trial.mag_ut * FRD_OF_SENSOR * GAUSS_PER_MICRO_TESLA
    return Estimator(rate_hz=trial.rate_hz).update_batch(gyr, acc, mag).q_enu_flu


def vqf_batch(trial: Trial) -> Array:
    """The same of vqf."""
    result = VQF(trial.dt_s).updateBatch(trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut)
    return np.asarray(result["quat9D"])


def main() -> None:
    """Every trial of the folder with both."""
    trials = load_trials(Path(sys.argv[1]))
    filters: dict[str, Filter] = {"fuzzbee": fuzzbee_batch, "vqf": vqf_batch}
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in filters}
    fuzzbee_batch(trials[0])  # compiles it
    for trial in trials:
        for name, run in filters.items():
            begin = time.process_time()
            q = run(trial)
            microseconds = 1e6 * (time.process_time() - begin) / len(q)
            found[name].append((score(trial, q).total, microseconds))
        figures = "  ".join(f"{name} {rows[-1][0]:.2f}" for name, rows in found.items())
        print(f"{trial.name:45} {figures}")
    for name, rows in found.items():
        errors, speeds = np.array(rows).T
        print(f"{name:8} mean {errors.mean():.2f} deg, median {np.median(speeds):.2f} us a sample")
    lower = sum(a[0] < b[0] for a, b in zip(*found.values(), strict=True))
    print(f"fuzzbee's is lower in {lower} of {len(trials)}")


if __name__ == "__main__":
    main()
