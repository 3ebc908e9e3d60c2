"""How an IMU sits in the vehicle: from the sensor's axes to the body's, FRD.

v_body = R_z(yaw) R_y(pitch) R_x(roll) v_sensor for the rate, the specific force and the field.
An accelerometer that gives gravity instead of the specific force has the other sign.
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


class Mounting(Struct, frozen=True, forbid_unknown_fields=True):
    """The profile's section; ``rotation_deg`` is roll, pitch and yaw in degrees."""

    rotation_deg: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    acc_sign: Literal[1, -1] = 1

    @property
    def has_body_axes(self) -> bool:
        """Whether the sensor's axes are the body's."""
        return self.acc_sign == 1 and not any(self.rotation_deg)

    @property
    def q_frd_sensor(self) -> Quaternion:
        """The rotation from the sensor's axes to the body's."""
        roll_deg, pitch_deg, yaw_deg = self.rotation_deg
        return from_euler_rad(radians(roll_deg), radians(pitch_deg), radians(yaw_deg))

    def to_body_axes(self, sample: ImuSample) -> ImuSample:
        """A sample of the sensor as the body would have it."""
        if self.has_body_axes:
            return sample
        q, acc = self.q_frd_sensor, scale(float(self.acc_sign), sample.acc_m_s2)
        return sample._replace(
            gyr_rad_s=rotate(q, sample.gyr_rad_s),
            acc_m_s2=rotate(q, acc),
            mag_gauss=rotate(q, sample.mag_gauss),
        )

    def to_body_rows(self, gyr: Floats, acc: Floats, mag: Floats) -> tuple[Floats, Floats, Floats]:
        """Readings (N, 3) of the sensor as the body would have them."""
        if self.has_body_axes:
            return gyr, acc, mag
        q = self.q_frd_sensor
        return (
            _rotate_rows(q, gyr),
            _rotate_rows(q, float(self.acc_sign) * acc),
            _rotate_rows(q, mag),
        )


def _rotate_rows(q: Quaternion, v: Floats) -> Floats:
    columns: Any = (v[:, 0], v[:, 1], v[:, 2])
    return np.column_stack(rotate(q, columns))
