"""imufusion (x-io), with its own gyroscope bias filter."""

import imufusion
import numpy as np
from broad_data import Array, Trial
from broad_scores import conjugate, multiply

STANDARD_GRAVITY_M_S2 = 9.80665
# Best common settings over the trials this was developed on.
GAIN = 0.2
ACCELERATION_REJECTION_DEG = 10.0
MAGNETIC_REJECTION_DEG = 10.0
REJECTION_TIMEOUT_S = 10.0


class ImufusionRun:
    """imufusion on one trial."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial
        settings = imufusion.AhrsSettings()
        # The constructor ignores its arguments.
        settings.sample_rate = trial.rate_hz
        settings.convention = imufusion.CONVENTION_ENU
        settings.gain = GAIN
        settings.gyroscope_range = 0.0
        settings.acceleration_rejection = ACCELERATION_REJECTION_DEG
        settings.magnetic_rejection = MAGNETIC_REJECTION_DEG
        settings.rejection_timeout = REJECTION_TIMEOUT_S
        self._ahrs = imufusion.Ahrs()
        self._ahrs.set_settings(settings)
        bias = imufusion.BiasSettings()
        bias.sample_rate = trial.rate_hz
        self._bias = imufusion.Bias()
        self._bias.set_settings(bias)

    def advance(self, rows: slice) -> Array:
        """Take the rows, in order."""
        t = self._trial
        gyr = np.degrees(t.gyr_rad_s[rows])
        acc = t.acc_m_s2[rows] / STANDARD_GRAVITY_M_S2
        mag = t.mag_ut[rows]
        out = np.empty((len(gyr), 4))
        for k in range(len(gyr)):
            self._ahrs.update(self._bias.update(gyr[k]), acc[k], mag[k])
            out[k] = self._ahrs.get_quaternion()
        return out

    def turn(self, turn_enu: Array) -> None:
        """Turn every attitude inside by one body rotation."""
        q = np.array(self._ahrs.get_quaternion(), dtype=float)
        body = multiply(conjugate(q), multiply(turn_enu, q))
        self._ahrs.set_quaternion(multiply(q, body))


class ImufusionFilter:
    """imufusion with common settings."""

    name = "imufusion"

    def start(self, trial: Trial) -> ImufusionRun:
        """Begin on the trial."""
        return ImufusionRun(trial)

    def call_each(self, trial: Trial, rows: int) -> None:
        """One call a sample."""
        ImufusionRun(trial).advance(slice(0, rows))
