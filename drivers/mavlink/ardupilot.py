"""Autopilots' parameters by name, and calibrations as ArduPilot's parameters.

Source of the names: https://ardupilot.org/copter/docs/parameters.html.

A compass: ArduPilot sends ``m = scale D (raw + OFS)`` in mGauss, D symmetric of DIA and ODI
(``AP_Compass_Backend::correct_field``). Corrected once more to S (m - b) that is
``scale D' (raw + OFS')`` with ``D' = S D`` and ``OFS' = OFS - (scale D)^-1 b``. Behind that it adds
MOT I for a current I if COMPASS_MOTCT is 2: of S (m - b - c I), ``MOT' = S (MOT - c)``.

An IMU: it sends rates ``raw - GYROFFS`` and forces ``ACCSCAL (raw - ACCOFFS)``, scales an axis
(``AP_InertialSensor_Backend``), and knows no crossed axes and no scale of a gyroscope. Corrected
once more to M (a - b) that is ACCOFFS' = ACCOFFS + b / ACCSCAL, ACCSCAL' = M's diagonal ACCSCAL.
"""

from collections.abc import Mapping
from math import radians
from typing import NamedTuple

import numpy as np

from drivers.mavlink.dialect import mavlink
from estimator.arrays import Floats
from estimator.calibration import Calibration
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.rotations import rotate

COMPASS = "COMPASS_"
# What calibrating the first compass has found, in mGauss; all zero: nobody has calibrated it
COMPASS_OFFSETS = ("COMPASS_OFS_X", "COMPASS_OFS_Y", "COMPASS_OFS_Z")
# The same of PX4, in gauss: docs.px4.io/main/en/advanced_config/parameter_reference.html
PX4_COMPASS_OFFSETS = ("CAL_MAG0_XOFF", "CAL_MAG0_YOFF", "CAL_MAG0_ZOFF")
# The cutoffs of the sensors' low-passes, Hz: Butterworth filters of second order
GYRO_FILTER, ACC_FILTER = "INS_GYRO_FILTER", "INS_ACCEL_FILTER"
ROVER_FILTERS_HZ = {GYRO_FILTER: 4.0, ACC_FILTER: 10.0}  # as delivered; of other vehicles 20
COMPASS_DECLINATION = "COMPASS_DEC"  # rad
# The mounting trim, rad: roll, pitch and yaw of the IMU in the vehicle it reports on
TRIM = ("AHRS_TRIM_X", "AHRS_TRIM_Y", "AHRS_TRIM_Z")
ORIENTATION = "AHRS_ORIENTATION"  # of the board in the vehicle; applied before anything is sent
SYSTEM_ID = ("SYSID_THISMAV", "MAV_SYSID")  # until 4.6, and since

AXES = "XYZ"
MILLIGAUSS = 1e3  # in a gauss
NUMBERS = {"SCALED_IMU2": "2", "SCALED_IMU3": "3"}  # other messages carry the first sensors
MOTORS, BY_CURRENT = f"{COMPASS}MOTCT", 2.0
INERTIAL = "INS_"
ROTATION = "MAV_SENSOR_ROTATION_"
OFF_DIAGONAL = ((0, 1), (0, 2), (1, 2))  # of ODI_X, ODI_Y and ODI_Z

Parameters = Mapping[str, float]


def _values(was: Parameters, name: str, default: float) -> Floats:
    return np.array([was.get(f"{name}_{axis}", default) for axis in AXES])


def _named(values: Mapping[str, Floats]) -> dict[str, float]:
    """A parameter for each axis."""
    return {
        f"{name}_{axis}": float(value)
        for name, three in values.items()
        for axis, value in zip(AXES, three, strict=True)
    }


def corrected(
    was: Parameters,
    message: str,
    offset_gauss: Floats,
    matrix: Floats | None,
    current_gauss_a: Floats | None = None,
) -> dict[str, float]:
    """What to set for S (m - b - c I), given what was set; without a matrix S is 1.

    A parameter that is not in ``was`` counts as ArduPilot's default.
    """
    number = NUMBERS.get(message, "")

    def values(name: str, default: float) -> Floats:
        return _values(was, f"{COMPASS}{name}{number}", default)

    scale = was.get(f"{COMPASS}SCALE{number}", 0.0) or 1.0
    d = np.diag(values("DIA", 1.0))
    if not d.any():  # ArduPilot takes zeros for none
        d = np.eye(3)
    for (i, j), value in zip(OFF_DIAGONAL, values("ODI", 0.0), strict=True):
        d[i, j] = d[j, i] = value
    changed = {"OFS": values("OFS", 0.0) - np.linalg.solve(scale * d, MILLIGAUSS * offset_gauss)}
    if matrix is not None:
        d = matrix @ d
        d = (d + d.T) / 2.0  # ArduPilot has no more; what turns the field is left out
        changed |= {"DIA": np.diag(d), "ODI": np.array([d[at] for at in OFF_DIAGONAL])}
    single = {}
    if current_gauss_a is not None:
        motor = values("MOT", 0.0) if was.get(MOTORS) == BY_CURRENT else np.zeros(3)
        motor = motor - MILLIGAUSS * current_gauss_a
        changed["MOT"] = motor if matrix is None else matrix @ motor
        single[MOTORS] = BY_CURRENT
    return single | _named({f"{COMPASS}{name}{number}": v for name, v in changed.items()})


class Orientation(NamedTuple):
    """A parameter, its value, and what MAV_SENSOR_ORIENTATION calls that."""

    parameter: str
    value: int
    meaning: str


def orientation(turn: Floats, was: Parameters, message: str) -> Orientation | None:
    """The COMPASS_ORIENT of a compass whose readings ``turn`` (3, 3) takes into the body's axes.

    None if that is no multiple of right angles (MAV_SENSOR_ORIENTATION), or a custom one was set.
    """
    number = NUMBERS.get(message, "")
    name = f"{COMPASS}ORIENT{number}"
    known = _rotations()
    before = {value: R for value, _, R in known}.get(int(was.get(name, 0.0)))
    if before is None:
        return None
    wanted = turn @ before
    for value, meaning, R in known:
        if np.allclose(R, wanted):
            return Orientation(name, value, meaning)
    return None


def _rotations() -> list[tuple[int, str, Floats]]:
    """Number, name and matrix (sensor to body) of each orientation by right angles."""
    found: list[tuple[int, str, Floats]] = []
    for value, entry in mavlink().enums["MAV_SENSOR_ORIENTATION"].items():
        words = entry.name.removeprefix(ROTATION).split("_")
        angles = dict(zip(words[::2], words[1::2], strict=False))
        if words != ["NONE"] and not all(each.isdigit() for each in words[1::2]):
            continue
        degrees = [int(angles.get(axis, 0)) for axis in ("ROLL", "PITCH", "YAW")]
        if entry.name.startswith(ROTATION) and not any(each % 90 for each in degrees):
            q = np.array([from_euler_rad(*map(radians, degrees))] * 3)
            found.append((value, "_".join(words), rotate(q, np.eye(3)).T.round()))
    return found


def inertial_parameters(was: Parameters, message: str, found: Calibration) -> dict[str, float]:
    """What to set for that calibration, in the IMU's axes, given what was set; none of no change.

    A parameter that is not in ``was`` counts as ArduPilot's default. A board that is turned in
    its vehicle has none: the parameters are in the board's axes.
    """
    if was.get(ORIENTATION):
        return {}
    number = NUMBERS.get(message, "")
    gyr = f"{INERTIAL}GYR{number}OFFS" if number else f"{INERTIAL}GYROFFS"
    acc = f"{INERTIAL}ACC{number}"

    changed: dict[str, Floats] = {}
    if any(found.gyr_bias_rad_s):
        changed[gyr] = _values(was, gyr, 0.0) + found.gyr_bias_rad_s
    scales = np.diag(np.array(found.acc_matrix))
    if any(found.acc_bias_m_s2) or (scales != 1.0).any():
        before = _values(was, f"{acc}SCAL", 1.0)
        before = np.where(before == 0.0, 1.0, before)
        changed[f"{acc}OFFS"] = (
            _values(was, f"{acc}OFFS", 0.0) + np.array(found.acc_bias_m_s2) / before
        )
        changed[f"{acc}SCAL"] = scales * before
    return _named(changed)
