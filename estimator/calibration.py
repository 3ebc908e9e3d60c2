"""Constant errors of an IMU's sensors, corrected in its readings before all else.

For each sensor v = M (reading - b), in the sensor's axes: b is the gyroscope's or accelerometer's
bias or the compass's hard iron, M its scales and crossed axes, for the compass with its soft iron.
"""

from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from estimator.types import Vec3

Rate = Annotated[float, Meta(ge=-10.0, le=10.0)]
Acceleration = Annotated[float, Meta(ge=-100.0, le=100.0)]
Gauss = Annotated[float, Meta(ge=-10.0, le=10.0)]
Element = Annotated[float, Meta(ge=-10.0, le=10.0)]
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
