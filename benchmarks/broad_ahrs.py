"""Mahony's and Madgwick's filters as the ahrs package has them."""

from typing import Any

import numpy as np
from ahrs.filters import Madgwick, Mahony
from broad_data import Array, Trial
from broad_scores import conjugate, multiply

# Madgwick's earth frame in ahrs is north-west-up (turned about up by 90 degrees
# that is ENU), Mahony's is ENU itself.
Q_ENU_NWU = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
Q_ENU_ENU = np.array([1.0, 0.0, 0.0, 0.0])
# Best common gains over the trials this was developed on.
MAHONY_KP = 0.3
MAHONY_KI = 1e-6  # ahrs refuses zero
MADGWICK_BETA = 0.1


class AhrsRun:
    """A filter of ahrs on one trial; its whole state is the quaternion (and Mahony's bias)."""

    def __init__(self, trial: Trial, filter_: Any, q_enu_earth: Array) -> None:
        self._trial = trial
        self._q_enu_earth = q_enu_earth
        self._filter = filter_
        self._q: Array | None = None

    def advance(self, rows: slice) -> Array:
        """Take the rows, in order."""
        t = self._trial
        gyr, acc, mag = t.gyr_rad_s[rows], t.acc_m_s2[rows], t.mag_ut[rows]
        out = np.empty((len(gyr), 4))
        if self._q is None:
            up = align(acc[0], mag[0])
            self._q = multiply(conjugate(self._q_enu_earth), multiply(Q_ENU_NWU, up))
        q = self._q
        for k in range(len(gyr)):
            q = self._filter.updateMARG(q, gyr[k], acc[k], mag[k], t.dt_s)
            out[k] = q
        self._q = q
        return multiply(self._q_enu_earth, out)

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude inside by one body rotation."""
        assert self._q is not None
        q = multiply(self._q_enu_earth, self._q)
        body = multiply(conjugate(q), multiply(turn_enu, q))
        self._q = multiply(self._q, body)


def align(acc: Array, mag: Array) -> Array:
    """The attitude from one sample, sensor to north-west-up."""
    from scipy.spatial.transform import Rotation

    up = acc / np.linalg.norm(acc)
    west = np.cross(up, mag)
    west /= np.linalg.norm(west)
    rows = np.array([np.cross(west, up), west, up])
    x, y, z, w = Rotation.from_matrix(rows).as_quat()
    return np.array([w, x, y, z])


class MahonyFilter:
    """Mahony with common gains."""

    name = "mahony"

    def __init__(self, k_p: float = MAHONY_KP, k_i: float = MAHONY_KI) -> None:
        self._gains = (k_p, k_i)

    def start(self, trial: Trial) -> AhrsRun:
        """Begin on the trial."""
        k_p, k_i = self._gains
        return AhrsRun(trial, Mahony(frequency=trial.rate_hz, k_P=k_p, k_I=k_i), Q_ENU_ENU)

    def call_each(self, trial: Trial, rows: int) -> None:
        """One call a sample."""
        self.start(trial).advance(slice(0, rows))


class MadgwickFilter:
    """Madgwick with a common gain."""

    name = "madgwick"

    def __init__(self, beta: float = MADGWICK_BETA) -> None:
        self._beta = beta

    def start(self, trial: Trial) -> AhrsRun:
        """Begin on the trial."""
        return AhrsRun(trial, Madgwick(frequency=trial.rate_hz, gain=self._beta), Q_ENU_NWU)

    def call_each(self, trial: Trial, rows: int) -> None:
        """One call a sample."""
        self.start(trial).advance(slice(0, rows))
