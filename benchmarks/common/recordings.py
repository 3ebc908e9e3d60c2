"""Recordings of an IMU beside optical truth, in the format of BROAD (doi 10.3390/data6070072)."""

from argparse import Namespace
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat

from estimator.geometry.rotations import exp, rotate_inverse, running_product
from estimator.types import IDENTITY

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

MADE_UP_HZ, MADE_UP_S, REST_S = 100.0, 60.0, 12.0
SMOKE_S = 60.0
COLUMNS = ("gyr_rad_s", "acc_m_s2", "mag_ut", "q_enu_sensor", "scored", "moving")


@dataclass(frozen=True)
class Trial:
    """One recording, rows in time. Sensor frame x, y, z up; truth from sensor to ENU, w first.

    ``scored`` marks the rows that count: motion, and the markers in sight. A sensor without a
    magnetometer has NaN in ``mag_ut``. ``averaged``: a row is the mean over its interval.
    """

    name: str
    rate_hz: float
    gyr_rad_s: Array
    acc_m_s2: Array
    mag_ut: Array
    q_enu_sensor: Array
    scored: Bools
    moving: Bools
    averaged: bool = False

    @property
    def dt_s(self) -> float:
        """Sample interval."""
        return 1.0 / self.rate_hz

    @property
    def times_s(self) -> Array:
        """(N,), from 0 on."""
        return np.arange(len(self.moving)) * self.dt_s

    @property
    def has_mag(self) -> bool:
        """Whether there is a magnetometer."""
        return bool(np.isfinite(self.mag_ut).any())

    @property
    def field_ut(self) -> float:
        """The usual norm of the field."""
        return float(np.median(np.linalg.norm(self.mag_ut, axis=1)))

    def cut(self, rows: slice) -> "Trial":
        """These rows; with a step, the rate is that much lower."""
        columns = {name: np.ascontiguousarray(getattr(self, name)[rows]) for name in COLUMNS}
        return replace(self, rate_hz=self.rate_hz / (rows.step or 1), **columns)


def chosen_sets(options: Namespace) -> dict[str, list[Trial]]:
    """The recordings by folder; for a smoke test a part of the first one, or made up without any.

    Raises:
        SystemExit: there is no recording.
    """
    if options.smoke and not options.folders:
        return {"made up": [made_up()]}
    sets: dict[str, list[Trial]] = {}
    for folder in options.folders:
        paths = sorted(folder.glob("*.mat"))
        if options.undisturbed:
            paths = [path for path in paths if "_disturbed_" not in path.stem]
        sets[folder.name] = [*map(load_trial, paths[:1] if options.smoke else paths)]
    if not sets or not all(sets.values()):
        raise SystemExit("give folders with BROAD's *.mat files, or --smoke")
    if options.smoke:
        return {n: [t.cut(slice(0, round(SMOKE_S * t.rate_hz)))] for n, (t,) in sets.items()}
    return sets


def load_trial(path: Path) -> Trial:
    """One file."""
    data = loadmat(path, squeeze_me=True)
    q, moving = np.array(data["opt_quat"], float), np.array(data["movement"], bool)
    readings = (np.ascontiguousarray(data[f"imu_{name}"], float) for name in ("gyr", "acc", "mag"))
    scored = moving & ~np.isnan(q).any(axis=1)
    return Trial(path.stem, float(data["sampling_rate"]), *readings, q, scored, moving)


def made_up() -> Trial:
    """A minute of an IMU that rests and is then turned and shaken, for where no folder is."""
    rng = np.random.default_rng(0)
    n, dt_s = round(MADE_UP_S * MADE_UP_HZ), 1.0 / MADE_UP_HZ
    t = np.arange(n) * dt_s
    moving = t >= REST_S
    tones = rng.uniform(0.2, 0.7, (3, 3))
    turns = 2.0 * np.pi * tones[:, :, None] * (t - REST_S) + rng.uniform(0.0, 6.0, (3, 3, 1))
    waves = np.sin(turns).sum(axis=1).T
    near = np.clip((t - REST_S) / 2.0, 0.0, 1.0)[:, None]
    rate, pushed = near * waves, near * waves[:, ::-1]
    truth = running_product(np.vstack([[IDENTITY], exp(rate[:-1] * dt_s)]))
    gyr = rate + 0.005 + rng.normal(0.0, 0.005, (n, 3))
    acc = rotate_inverse(truth, np.add(pushed, (0.0, 0.0, 9.81))) + rng.normal(0.0, 0.03, (n, 3))
    mag = rotate_inverse(truth, (0.0, 20.0, -42.0)) + rng.normal(0.0, 0.3, (n, 3))
    return Trial("made up", MADE_UP_HZ, gyr, acc, mag, truth, moving, moving)
