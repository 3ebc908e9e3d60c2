"""Attitudes as arrays, a row for each: what programs are given for many samples."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.geometry.frames import Q_ENU_NED, Q_FRD_FLU, euler_rad
from estimator.geometry.rotations import multiply, unit
from estimator.live.rows import BIAS, NORTH, NORTHS, RATE, Q
from estimator.types import Attitude, Floats, Times

PLACE = {north: place for place, north in enumerate(NORTHS)}
ADDED = ("time_s", "heading_reference", "warnings")


@dataclass(frozen=True)
class Attitudes:
    """N attitudes in time; NaN where there is none, as before the first sample that can be used.

    ``q_ned_frd`` (N, 4) is Hamilton, scalar first, and takes body vectors (forward, right, down)
    to north, east, down. The sigmas (N,) are the angles that 68 % of the errors lie under,
    of the inclination and of the heading. ``heading_reference`` (N,) is what the heading is
    measured from: "true" or "magnetic" north, or "none". ``error`` is the paper's e(R~) from the
    measurements, ``gain`` its K. ``warnings`` name units and axes that would fit better.
    """

    time_s: Floats
    q_ned_frd: Floats
    rate_rad_s: Floats
    gyro_bias_rad_s: Floats
    sigma_inclination_rad: Floats
    sigma_heading_rad: Floats
    confidence_gravity: Floats
    confidence_magnetic: Floats
    error: Floats
    gain: Floats
    heading_reference: NDArray[np.str_]
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def euler_deg(self) -> Floats:
        """Roll, pitch and yaw (N, 3) in degrees, yaw from 0 to 360; to be looked at only."""
        return euler_curves_deg(self.q_ned_frd)

    def to_rotation(self) -> Any:
        """SciPy's ``Rotation``, body vectors (FRD) to NED, of the attitudes that are known."""
        from scipy.spatial.transform import Rotation

        known = np.isfinite(self.q_ned_frd).all(axis=1)
        return Rotation.from_quat(self.q_ned_frd[known][:, [1, 2, 3, 0]])

    def to_frame(self) -> Any:
        """A pandas ``DataFrame`` over ``time_s``: a column for each number, angles in degrees.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise InputError("to_frame needs pandas: pip install pandas") from None
        columns = {
            **dict(zip(("w", "x", "y", "z"), self.q_ned_frd.T, strict=True)),
            **dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), self.euler_deg.T, strict=True)),
            "sigma_inclination_deg": np.degrees(self.sigma_inclination_rad),
            "sigma_heading_deg": np.degrees(self.sigma_heading_rad),
            "heading_reference": self.heading_reference,
        }
        return pd.DataFrame(columns, index=pd.Index(self.time_s, name="time_s"))

    @property
    def q_enu_flu(self) -> Floats:
        """The attitudes (N, 4) as ROS has them: forward, left, up to east, north, up."""
        return enu_flu(self.q_ned_frd)


def euler_curves_deg(q_ned_frd: Floats) -> Floats:
    """Roll, pitch, heading in degrees (N, 3) of attitudes (N, 4), NaN where there is none."""
    angles = [euler_rad((w, x, y, z)) for w, x, y, z in q_ned_frd.tolist()]
    return np.where(np.isnan(q_ned_frd[:, :1]), np.nan, np.degrees(angles).reshape(-1, 3))


def enu_flu(q_ned_frd: Floats) -> Floats:
    """Attitudes (N, 4) as ROS has them; NaN where there is none."""
    return unit(multiply(multiply(np.array(Q_ENU_NED), q_ned_frd), np.array(Q_FRD_FLU)))


def attitudes_of(columns: Any, start_us: int = 0, warnings: tuple[str, ...] = ()) -> Attitudes:
    """The attitudes in columns by name, as those of a replay's trace are."""
    own = (field.name for field in fields(Attitudes) if field.name not in ADDED)
    same: Any = {name: np.array(columns[name]) for name in own}
    time_s = np.asarray(1e-6 * (columns["time_us"] - start_us), dtype=float)
    norths = np.array(NORTHS).take(columns["heading_reference"].astype(np.uint8))
    return Attitudes(time_s=time_s, heading_reference=norths, warnings=warnings, **same)


def attitudes_of_rows(times_us: Times, published: Floats, warnings: tuple[str, ...]) -> Attitudes:
    """The columns of rows as :mod:`estimator.live.rows` has them."""
    vectors = (published[:, columns] for columns in (Q, RATE, BIAS))
    values = (times_us, *vectors, *published.T[BIAS.stop : NORTH + 1])
    return attitudes_of(dict(zip(Attitude._fields, values, strict=True)), warnings=warnings)
