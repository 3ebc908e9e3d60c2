"""How an IMU sits in the vehicle: from the sensor's axes to the body's, FRD.

v_body = R_z(yaw) R_y(pitch) R_x(roll) v_sensor for the rate, the specific force and the field.
An accelerometer that gives gravity instead of the specific force has the other sign. What iron in
the vehicle does to the field is taken away in the body's axes: m = S (m_body - offset).
"""

from math import radians
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta, Struct

from estimator.arrays import Floats
from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate, scale
from estimator.types import ImuSample, Quaternion

Angle = Annotated[float, Meta(ge=-180.0, le=180.0)]
Gauss = Annotated[float, Meta(ge=-10.0, le=10.0)]
Element = Annotated[float, Meta(ge=-10.0, le=10.0)]
Row = tuple[Element, Element, Element]

UNCHANGED: tuple[Row, Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Mounting(Struct, frozen=True, forbid_unknown_fields=True):
    """The profile's section; ``rotation_deg`` is roll, pitch and yaw in degrees.

    ``mag_offset_gauss`` (hard iron) and the rows of S, ``mag_matrix`` (soft iron), are in the
    body's axes, as ``fuzzbee calibrate`` prints them.
    """

    rotation_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    acc_sign: Literal[1, -1] = 1
    mag_offset_gauss: tuple[Gauss, Gauss, Gauss] = (0.0, 0.0, 0.0)
    mag_matrix: tuple[Row, Row, Row] = UNCHANGED

    def __post_init__(self) -> None:
        """Raise ValueError if S turns a field into none."""
        if not np.linalg.det(np.array(self.mag_matrix)) > 0.0:
            raise ValueError("mag_matrix: its determinant must be positive")

    @property
    def has_body_axes(self) -> bool:
        """Whether the sensor's axes are the body's."""
        return self.acc_sign == 1 and not any(self.rotation_deg)

    @property
    def is_plain(self) -> bool:
        """Whether samples stay as they are."""
        return self.has_body_axes and not self.has_iron

    @property
    def has_iron(self) -> bool:
        """Whether anything is taken away from the field."""
        return any(self.mag_offset_gauss) or self.mag_matrix != UNCHANGED

    @property
    def q_frd_sensor(self) -> Quaternion:
        """The rotation from the sensor's axes to the body's."""
        roll_deg, pitch_deg, yaw_deg = self.rotation_deg
        return from_euler_rad(radians(roll_deg), radians(pitch_deg), radians(yaw_deg))

    def to_body_axes(self, sample: ImuSample) -> ImuSample:
        """A sample of the sensor as the body would have it."""
        if self.is_plain:
            return sample
        q, acc = self.q_frd_sensor, scale(float(self.acc_sign), sample.acc_m_s2)
        return sample._replace(
            gyr_rad_s=rotate(q, sample.gyr_rad_s),
            acc_m_s2=rotate(q, acc),
            mag_gauss=self._less_iron(*rotate(q, sample.mag_gauss)),
        )

    def to_body_rows(self, gyr: Floats, acc: Floats, mag: Floats) -> tuple[Floats, Floats, Floats]:
        """Readings (N, 3) of the sensor as the body would have them."""
        if self.is_plain:
            return gyr, acc, mag
        q = self.q_frd_sensor
        return (
            _rotate_rows(q, gyr),
            _rotate_rows(q, float(self.acc_sign) * acc),
            np.column_stack(self._less_iron(*_rotate_rows(q, mag).T)),
        )

    def _less_iron(self, x: Any, y: Any, z: Any) -> Any:
        """The field without iron's, of one reading or of columns; no field stays none."""
        if not self.has_iron:
            return x, y, z
        there = (x != 0.0) | (y != 0.0) | (z != 0.0)
        a, b, c = (v - o for v, o in zip((x, y, z), self.mag_offset_gauss, strict=True))
        return tuple((i * a + j * b + k * c) * there for i, j, k in self.mag_matrix)


def _rotate_rows(q: Quaternion, v: Floats) -> Floats:
    columns: Any = (v[:, 0], v[:, 1], v[:, 2])
    return np.column_stack(rotate(q, columns))
