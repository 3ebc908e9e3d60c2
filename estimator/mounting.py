"""How an IMU sits in the vehicle: from the sensor's axes to the body's, FRD.

v_body = R_z(yaw) R_y(pitch) R_x(roll) v_sensor for the rate, the specific force and the field. An
accelerometer that gives gravity instead of the specific force has the other sign.
"""

from math import radians
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from estimator.geometry.frames import from_euler_rad
from estimator.geometry.quaternion import rotate, scale
from estimator.types import Quaternion

Angle = Annotated[float, Meta(ge=-180.0, le=180.0)]


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
