"""VQF (Laidig and Seel 2023), its own package."""

import numpy as np
from broad_data import Array, Trial
from broad_scores import conjugate, multiply
from vqf import VQF


class VqfRun:
    """VQF on one trial."""

    def __init__(self, trial: Trial, tau_mag_s: float) -> None:
        self._trial = trial
        self._vqf = VQF(trial.dt_s, tauMag=tau_mag_s)

    def advance(self, rows: slice) -> Array:
        """Take the rows, in order."""
        t = self._trial
        result = self._vqf.updateBatch(t.gyr_rad_s[rows], t.acc_m_s2[rows], t.mag_ut[rows])
        return np.asarray(result["quat9D"])

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude inside by one body rotation."""
        q = self._vqf.getQuat9D()
        body = multiply(conjugate(q), multiply(turn_enu, q))
        state = self._vqf.state
        state["gyrQuat"] = list(multiply(np.array(state["gyrQuat"]), body))
        self._vqf.state = state


class VqfFilter:
    """VQF with its defaults but tauMag."""

    def __init__(self, name: str, tau_mag_s: float) -> None:
        self.name = name
        self._tau_mag_s = tau_mag_s

    def start(self, trial: Trial) -> VqfRun:
        """Begin on the trial."""
        return VqfRun(trial, self._tau_mag_s)

    def call_each(self, trial: Trial, rows: int) -> None:
        """One call a sample."""
        vqf = VQF(trial.dt_s, tauMag=self._tau_mag_s)
        gyr, acc, mag = trial.gyr_rad_s[:rows], trial.acc_m_s2[:rows], trial.mag_ut[:rows]
        for g, a, m in zip(gyr, acc, mag, strict=True):
            vqf.update(g, a, m)


def run_vqf(trial: Trial) -> Array:
    """VQF with its defaults over the whole trial."""
    return VqfFilter("vqf", 9.0).start(trial).advance(slice(0, None))
