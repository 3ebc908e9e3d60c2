"""The live estimator with its ``imu`` profile on a trial, and what it says of its own error."""

from typing import NamedTuple

import numpy as np
from broad_data import Array, Trial
from broad_fuzzbee import (
    ENU_SENSOR_OF_NED_FRD,
    FRD_OF_SENSOR,
    MICRO_TESLA_PER_GAUSS,
    Q_ENU_NED,
    sample_of,
)

from estimator.estimator import Estimator
from estimator.geometry.quaternion import conjugate, multiply
from estimator.live.rows import SAID, Rows, cut, rows_of
from estimator.live.snapshot import Snapshot
from estimator.profile import load_profile, merge_profile

# Columns of a row that tells an attitude.
SIGMA_INCLINATION, SIGMA_HEADING = 15, 16


class Said(NamedTuple):
    """N attitudes, sensor to ENU, w first, and the published sigmas in degrees."""

    q_enu_sensor: Array
    sigma_inclination_deg: Array
    sigma_heading_deg: Array


class LiveRun:
    """An estimator at work on one trial; it can go back to where it was."""

    def __init__(self, trial: Trial) -> None:
        averaged = {"conditioning": {"averaged_samples": trial.averaged}}
        self._estimator = Estimator(merge_profile(load_profile("imu"), averaged))
        self._estimator.update(sample_of(trial, 0))
        self._name = trial.name
        self._rows = rows_of_trial(trial)

    def advance(self, begin: int, end: int | None = None) -> Said:
        """Take the rows of the trial, in order; the first row of all has been taken."""
        rows = cut(self._rows, begin, end)
        said = np.full((len(rows.times_us), SAID), np.nan)
        taken = self._estimator.update_rows(rows, said)
        if taken < len(said):
            msg = f"{self._name}: row {begin + taken} was not taken"
            raise ValueError(msg)
        return Said(
            said[:, :4] @ ENU_SENSOR_OF_NED_FRD,
            np.degrees(said[:, SIGMA_INCLINATION]),
            np.degrees(said[:, SIGMA_HEADING]),
        )

    @property
    def snapshot(self) -> Snapshot:
        """Where it is."""
        return self._estimator.snapshot

    @snapshot.setter
    def snapshot(self, snapshot: Snapshot) -> None:
        self._estimator.snapshot = snapshot

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude inside, unsensed."""
        to_ned = tuple(Q_ENU_NED)
        self._estimator.turn(multiply(conjugate(to_ned), multiply(tuple(turn_enu), to_ned)))


def rows_of_trial(trial: Trial) -> Rows:
    """The readings as the live estimator takes them."""
    n = len(trial.gyr_rad_s)
    times = np.round(np.arange(n) * trial.dt_s * 1e6).astype(np.int64)
    vectors = (trial.gyr_rad_s, trial.acc_m_s2, trial.mag_ut / MICRO_TESLA_PER_GAUSS)
    return rows_of(times, *(v * FRD_OF_SENSOR for v in vectors), np.ones(n, np.bool_))


def run_live(trial: Trial) -> Said:
    """The whole trial; the first row is said as the second is."""
    said = LiveRun(trial).advance(1)
    return Said(*(np.concatenate([column[:1], column]) for column in said))
