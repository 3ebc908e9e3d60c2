"""Autopilots' parameters: their values, what they show, and calibrations as ArduPilot's parameters.

Source of the names: https://ardupilot.org/copter/docs/parameters.html.

A ground station that fetched the parameters as a file writes them to its log under an address
of its own on the vehicle's system (MAVProxy: component 190). They are the autopilot's.

An attitude that ArduPilot sends may be its IMU's, the vehicle's, or a view for its pilot. ArduPilot
trims the IMU in the vehicle. A plane shows its pitch less the one that it cruises with, and a
tailsitter shows a copter while it hovers: the same attitude, seen along another axis.

A compass: ArduPilot sends ``m = scale D (raw + OFS)`` in mGauss, D symmetric of DIA and ODI
(``AP_Compass_Backend::correct_field``). Corrected once more to S (m - b) that is
``scale D' (raw + OFS')`` with ``D' = S D`` and ``OFS' = OFS - (scale D)^-1 b``. Behind that it adds
MOT I for a current I if COMPASS_MOTCT is 2: of S (m - b - c I), ``MOT' = S (MOT - c)``.

An IMU: it sends rates ``raw - GYROFFS`` and forces ``ACCSCAL (raw - ACCOFFS)``, scales an axis
(``AP_InertialSensor_Backend``), and knows no crossed axes and no scale of a gyroscope. Corrected
once more to M (a - b) that is ACCOFFS' = ACCOFFS + b / ACCSCAL, ACCSCAL' = M's diagonal ACCSCAL.
"""

import struct
from collections.abc import Iterable, Mapping
from math import isfinite, pi, radians
from typing import NamedTuple

import numpy as np

from drivers.events import VehicleId
from drivers.mavlink import constants as mav
from estimator.calibration import Calibration
from estimator.geometry.frames import euler_rad, from_euler_rad
from estimator.geometry.quaternion import multiply
from estimator.geometry.rotations import rotate
from estimator.types import Floats, Quaternion

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

PITCH_TRIMS = {"PTCH_TRIM_DEG": radians(1.0), "TRIM_PITCH_CD": radians(0.01)}  # since 4.5, before
FLIGHT_OPTIONS, SHOWS_ALL = "FLIGHT_OPTIONS", 1 << 8  # the pitch is shown with that trim
IS_QUADPLANE, IS_TAILSITTER = "Q_ENABLE", "Q_TAILSIT_ENABLE"
VIEW_PARAMETERS = frozenset({*TRIM, *PITCH_TRIMS, FLIGHT_OPTIONS, IS_QUADPLANE, IS_TAILSITTER})
TAILSITTERS, VTOLS = frozenset((19, 20, 23)), frozenset(range(19, 26))  # MAV_TYPE
UPRIGHT = from_euler_rad(0.0, 0.5 * pi, 0.0)
TRIMMED_MESSAGE = "ATTITUDE"  # no other one leaves the pitch's trim out

AXES = "XYZ"
MILLIGAUSS = 1e3  # in a gauss
NUMBERS = {"SCALED_IMU2": "2", "SCALED_IMU3": "3"}  # other messages carry the first sensors
MOTORS, BY_CURRENT = f"{COMPASS}MOTCT", 2.0
INERTIAL = "INS_"
ROTATION = "MAV_SENSOR_ROTATION_"
OFF_DIAGONAL = ((0, 1), (0, 2), (1, 2))  # of ODI_X, ODI_Y and ODI_Z

# MAV_PARAM_TYPE_UINT8, INT8, UINT16, INT16, UINT32 and INT32
INTEGER_PARAMETERS = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}

Parameters = Mapping[str, float]


class ParameterValue(NamedTuple):
    """The fields of a PARAM_VALUE."""

    name: str
    raw: float
    kind: int  # MAV_PARAM_TYPE

    def value(self, autopilot: int | None) -> float:
        """The number: PX4 puts an integer's bytes into the float field, ArduPilot its value."""
        kind = INTEGER_PARAMETERS.get(self.kind)
        if autopilot != mav.MAV_AUTOPILOT_PX4 or kind is None:
            return self.raw
        return float(struct.unpack_from("<" + kind, struct.pack("<f", self.raw))[0])


def owner(sender: VehicleId, autopilots: Iterable[VehicleId]) -> VehicleId | None:
    """Whose parameter it is; None while no autopilot of the sender's system is known.

    An autopilot has parameters of its own. All others on a system send those of its
    autopilot's: of several, the one with the lowest component id, by convention 1.
    """
    if sender.component_id == mav.MAV_COMP_ID_AUTOPILOT1:
        return sender
    known = [each for each in autopilots if each.system_id == sender.system_id]
    return sender if sender in known else min(known, default=None)


class AttitudeView:
    """What parameters and HEARTBEAT show of it; ``vehicle_type`` is a MAV_TYPE."""

    def __init__(self) -> None:
        self.vehicle_type: int | None = None
        self._values: dict[str, float] = {}

    def take(self, name: str, value: float) -> None:
        """Note one of the parameters in :data:`VIEW_PARAMETERS`."""
        if isfinite(value):
            self._values[name] = value

    @property
    def is_imus(self) -> bool:
        """Whether what is shown is the IMU's attitude in any case."""
        return not any(self._values.values()) and self.vehicle_type not in VTOLS

    @property
    def trim(self) -> Quaternion:
        """From the vehicle's axes to those of its IMU."""
        return from_euler_rad(*(self._values.get(name, 0.0) for name in TRIM))

    def of_imu(self, message: str, shown: Quaternion, ours: Quaternion) -> Quaternion | None:
        """The attitude of the IMU that ``message`` shows; None if it is not known.

        Which view a vehicle shows that can hover depends on what it does: it is the one that is
        nearest to ``ours``.
        """
        trim = self.trim
        views = [multiply(view, trim) for view in self._views(message, shown)]
        nearest = max(views, key=lambda view: abs(sum(map(float.__mul__, view, ours))))
        is_sure = self._is_tailsitter is not None or nearest is not views[-1]
        return nearest if is_sure or len(views) == 1 else None

    @property
    def _is_tailsitter(self) -> bool | None:
        """None where neither a parameter nor the type shows."""
        if self.vehicle_type in TAILSITTERS:
            return True
        if IS_TAILSITTER in self._values:
            return self._values[IS_TAILSITTER] > 0.0
        return None if self.vehicle_type in VTOLS else False

    def _views(self, message: str, shown: Quaternion) -> list[Quaternion]:
        """What may be shown; a tailsitter's comes last."""
        if message != TRIMMED_MESSAGE:
            return [shown]
        trim_rad = sum(unit * self._values.get(name, 0.0) for name, unit in PITCH_TRIMS.items())
        if int(self._values.get(FLIGHT_OPTIONS, 0.0)) & SHOWS_ALL:
            trim_rad = 0.0
        views = [shown]
        if trim_rad:
            roll, pitch, yaw = euler_rad(shown)
            hovers = self._values.get(IS_QUADPLANE, 0.0) > 0.0 or self.vehicle_type in VTOLS
            views = [from_euler_rad(roll, pitch + trim_rad, yaw), *([shown] if hovers else [])]
        return views if self._is_tailsitter is False else [*views, multiply(shown, UPRIGHT)]


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
    known: list[tuple[Orientation, Floats]] = []  # by right angles, and from sensor to body
    for value, entry in mav.mavlink().enums["MAV_SENSOR_ORIENTATION"].items():
        words = entry.name.removeprefix(ROTATION).split("_")
        angles = dict(zip(words[::2], words[1::2], strict=False))
        if words != ["NONE"] and not words[-1].isdigit():  # a custom one, or the list's end
            continue
        degrees = [int(angles.get(axis, 0)) for axis in ("ROLL", "PITCH", "YAW")]
        if not any(each % 90 for each in degrees):
            q = np.array([from_euler_rad(*map(radians, degrees))] * 3)
            named = Orientation(name, value, "_".join(words))
            known.append((named, rotate(q, np.eye(3)).T.round()))
    before = {each.value: R for each, R in known}.get(int(was.get(name, 0.0)))
    if before is None:
        return None
    return next((each for each, R in known if np.allclose(R, turn @ before)), None)


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
        offset = np.array(found.acc_bias_m_s2) / before
        changed[f"{acc}OFFS"] = _values(was, f"{acc}OFFS", 0.0) + offset
        changed[f"{acc}SCAL"] = scales * before
    return _named(changed)
