"""BROAD trials: an IMU with optical ground truth (doi 10.3390/data6070072, CC BY 4.0)."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """One recording, rows in time. Sensor frame x, y, z up; truth from sensor to ENU, w first.

    ``scored`` marks the rows that count: motion, and the markers in sight.
    ``averaged`` tells that a row is the mean over its interval.
    """

    name: str
    groups: tuple[str, ...]
    rate_hz: float
    gyr_rad_s: Array
    acc_m_s2: Array
    mag_ut: Array
    q_enu_sensor: Array
    scored: NDArray[np.bool_]
    moving: NDArray[np.bool_]
    averaged: bool = False

    @property
    def dt_s(self) -> float:
        """Sample interval."""
        return 1.0 / self.rate_hz


def load_trials(folder: Path) -> list[Trial]:
    """Read every ``*.mat`` of the folder; groups come from its ``trials.json``, if there is one."""
    from scipy.io import loadmat

    index_file = folder / "trials.json"
    index = json.loads(index_file.read_text())["trials"] if index_file.exists() else {}
    trials = []
    for path in sorted(folder.glob("*.mat")):
        data = loadmat(path, squeeze_me=True)
        q = np.array(data["opt_quat"], dtype=float)
        moving = np.array(data["movement"], dtype=bool)
        trials.append(
            Trial(
                name=path.stem,
                groups=tuple(index.get(path.stem, {}).get("groups", ())),
                rate_hz=float(data["sampling_rate"]),
                gyr_rad_s=np.ascontiguousarray(data["imu_gyr"], dtype=float),
                acc_m_s2=np.ascontiguousarray(data["imu_acc"], dtype=float),
                mag_ut=np.ascontiguousarray(data["imu_mag"], dtype=float),
                q_enu_sensor=q,
                scored=moving & ~np.isnan(q).any(axis=1),
                moving=moving,
            )
        )
    return trials


def is_undisturbed(trial: Trial) -> bool:
    """Whether the trial has no disturbance, by group or by name."""
    return "undisturbed" in trial.groups or "_undisturbed_" in trial.name


def load_untroubled(folders: Iterable[Path]) -> list[Trial]:
    """The trials of all folders whose names tell of no disturbance; other sets name none."""
    trials = (trial for folder in folders for trial in load_trials(folder))
    return [trial for trial in trials if "_disturbed_" not in trial.name]


def crop(trial: Trial) -> Trial:
    """The trial from its first movement on: no rest at the start."""
    first = int(np.argmax(trial.moving))
    return cut(trial, slice(first, None))


def decimate(trial: Trial, rate_hz: float) -> Trial:
    """Block means of round(fs/rate) samples; truth and score are those of the block's end."""
    block = max(1, round(trial.rate_hz / rate_hz))
    if block == 1:
        return trial
    n = len(trial.gyr_rad_s) // block

    def mean(x: Array) -> Array:
        return np.ascontiguousarray(x[: n * block].reshape(n, block, 3).mean(axis=1))

    ends = slice(block - 1, n * block, block)
    return Trial(
        trial.name,
        trial.groups,
        trial.rate_hz / block,
        mean(trial.gyr_rad_s),
        mean(trial.acc_m_s2),
        mean(trial.mag_ut),
        trial.q_enu_sensor[ends],
        trial.scored[ends],
        trial.moving[ends],
        averaged=True,
    )


def cut(trial: Trial, rows: slice) -> Trial:
    """The trial's rows; with a step, its rate is that much lower."""
    step = rows.step or 1
    readings = {
        name: np.ascontiguousarray(getattr(trial, name)[rows])
        for name in ("gyr_rad_s", "acc_m_s2", "mag_ut", "q_enu_sensor", "scored", "moving")
    }
    return replace(trial, rate_hz=trial.rate_hz / step, **readings)
