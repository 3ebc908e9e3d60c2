"""A calibration of gyroscope and accelerometer as ArduPilot's parameters of an IMU.

ArduPilot sends rates ``raw - GYROFFS`` and forces ``ACCSCAL (raw - ACCOFFS)``, scales an axis
(``AP_InertialSensor_Backend``). It knows no crossed axes and no scale of a gyroscope. Corrected
once more to M (a - b) that is ACCOFFS' = ACCOFFS + b / ACCSCAL, ACCSCAL' = M's diagonal ACCSCAL.
"""

from collections.abc import Mapping

import numpy as np

from drivers.mavlink.ardupilot import ORIENTATION
from estimator.arrays import Floats
from estimator.calibration import Calibration

INERTIAL = "INS_"
AXES = "XYZ"
NUMBERS = {"SCALED_IMU2": "2", "SCALED_IMU3": "3"}  # other messages carry the first IMU


def inertial_parameters(
    was: Mapping[str, float], message: str, found: Calibration
) -> dict[str, float]:
    """What to set for that calibration, in the IMU's axes, given what was set; none of no change.

    A parameter that is not in ``was`` counts as ArduPilot's default. Of a board that is turned in
    its vehicle nothing is told: the parameters are in the board's axes.
    """
    if was.get(ORIENTATION):
        return {}
    number = NUMBERS.get(message, "")
    gyr = f"{INERTIAL}GYR{number}OFFS" if number else f"{INERTIAL}GYROFFS"
    acc = f"{INERTIAL}ACC{number}"

    def values(name: str, default: float) -> Floats:
        return np.array([was.get(f"{name}_{axis}", default) for axis in AXES])

    told: dict[str, Floats] = {}
    if any(found.gyr_bias_rad_s):
        told[gyr] = values(gyr, 0.0) + found.gyr_bias_rad_s
    scales = np.diag(np.array(found.acc_matrix))
    if any(found.acc_bias_m_s2) or (scales != 1.0).any():
        before = values(f"{acc}SCAL", 1.0)
        before = np.where(before == 0.0, 1.0, before)
        told[f"{acc}OFFS"] = values(f"{acc}OFFS", 0.0) + np.array(found.acc_bias_m_s2) / before
        told[f"{acc}SCAL"] = scales * before
    return {
        f"{name}_{axis}": float(value)
        for name, three in told.items()
        for axis, value in zip(AXES, three, strict=True)
    }
