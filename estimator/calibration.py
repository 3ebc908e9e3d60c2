"""An IMU's readings corrected before all else: the sensors' constant errors, then the mounting.

Calibration: for each sensor v = M (reading - b), in the sensor's axes: b is the gyroscope's or
accelerometer's bias or the compass's hard iron, M its scales and crossed axes, for the compass with
its soft iron.

Mounting: v_body = R_z(yaw) R_y(pitch) R_x(roll) v_sensor for the rate, the specific force and the
field, from the sensor's axes to the body's, FRD. An accelerometer that gives gravity instead of the
specific force has the other sign.
"""

from math import radians
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate, scale
from estimator.types import Quaternion, Vec3

Rate = Annotated[float, Meta(ge=-10.0, le=10.0)]
Acceleration = Annotated[float, Meta(ge=-100.0, le=100.0)]
Gauss = Annotated[float, Meta(ge=-10.0, le=10.0)]
Element = Annotated[float, Meta(ge=-10.0, le=10.0)]
Angle = Annotated[float, Meta(ge=-180.0, le=180.0)]
Row = tuple[Element, Element, Element]
Matrix = tuple[Row, Row, Row]

UNCHANGED: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
NONE: Vec3 = (0.0, 0.0, 0.0)


class Calibration(Struct, frozen=True, forbid_unknown_fields=True):
    """The profile's section, as ``fuzzbee calibrate`` writes it; a matrix is three rows."""

    gyr_bias_rad_s: tuple[Rate, Rate, Rate] = NONE
    gyr_matrix: Matrix = UNCHANGED
    acc_bias_m_s2: tuple[Acceleration, Acceleration, Acceleration] = NONE
    acc_matrix: Matrix = UNCHANGED
    mag_offset_gauss: tuple[Gauss, Gauss, Gauss] = NONE
    mag_matrix: Matrix = UNCHANGED

    def __post_init__(self) -> None:
        """Raise ValueError if a matrix makes nothing of some reading."""
        for name in ("gyr_matrix", "acc_matrix", "mag_matrix"):
            if not np.linalg.det(np.array(getattr(self, name))) > 0.0:
                raise ValueError(f"{name}: its determinant must be positive")

    @property
    def is_plain(self) -> bool:
        """Whether readings stay as they are."""
        return self == PLAIN

    def applied(self, gyr: Any, acc: Any, mag: Any) -> tuple[Any, Any, Any]:
        """Readings less their errors, of one sample or of columns; no field stays none."""
        x, y, z = mag
        there = (x != 0.0) | (y != 0.0) | (z != 0.0)
        field = _applied(self.mag_matrix, self.mag_offset_gauss, mag)
        return (
            _applied(self.gyr_matrix, self.gyr_bias_rad_s, gyr),
            _applied(self.acc_matrix, self.acc_bias_m_s2, acc),
            tuple(component * there for component in field),
        )


PLAIN = Calibration()


def _applied(matrix: Matrix, offset: Vec3, reading: Any) -> Any:
    """M (reading - b), of one reading or of columns."""
    x, y, z = (v - b for v, b in zip(reading, offset, strict=True))
    return tuple(i * x + j * y + k * z for i, j, k in matrix)


class Mounting(Struct, frozen=True, forbid_unknown_fields=True):
    """The profile's section; ``rotation_deg`` is roll, pitch and yaw in degrees."""

    rotation_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    acc_sign: Literal[1, -1] = 1

    @property
    def has_body_axes(self) -> bool:
        """Whether the sensor's axes are the body's."""
        return self == BODY_AXES

    @property
    def q_frd_sensor(self) -> Quaternion:
        """The rotation from the sensor's axes to the body's."""
        roll_deg, pitch_deg, yaw_deg = self.rotation_deg
        return from_euler_rad(radians(roll_deg), radians(pitch_deg), radians(yaw_deg))

    def applied(self, gyr: Any, acc: Any, mag: Any) -> tuple[Any, Any, Any]:
        """Readings of the sensor as the body would have them, of one sample or columns."""
        q = self.q_frd_sensor
        return rotate(q, gyr), rotate(q, scale(float(self.acc_sign), acc)), rotate(q, mag)


BODY_AXES = Mounting()
