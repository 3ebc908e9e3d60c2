"""The immutable values that all packages exchange.

Conventions, stated once:

* Frames: NED (north, east, down) is the inertial frame, FRD (forward, right,
  down) the body frame. Other frames exist only in ``estimator/geometry/frames.py``.
* Quaternions are Hamilton, scalar first, unit norm. ``q_ned_frd`` takes body
  vectors to inertial ones: ``v_ned = rotate(q_ned_frd, v_frd)``.
* SI units and radians everywhere, except the magnetic field, which is in
  gauss (MAVLink's unit) and of which only the direction and relative changes
  matter.
* ``time_us`` is the vehicle's own clock in microseconds, unwrapped, with
  reboots and jumps cut out: it only ever grows.

Except for arrays the values are ``NamedTuple``s of floats and tuples of floats: constant,
comparable, and readable by field name in a compiled kernel.
"""

from enum import Enum, auto
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]  # the shape is given where an array is used
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Times = Ints  # us

Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

ZERO_VEC3: Vec3 = (0.0, 0.0, 0.0)
DOWN: Vec3 = (0.0, 0.0, 1.0)  # in NED
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)

STANDARD_GRAVITY_M_S2 = 9.80665  # ISO 80000-3; MAVLink's "g" in mg fields


class ImuSample(NamedTuple):
    """One reading of gyroscope, accelerometer and, if present, magnetometer, in FRD.

    ``acc_m_s2`` is the specific force: (0, 0, -9.8) at rest and level. ``has_mag`` is False if the
    stream carried no field, a zero field, or a repetition of the previous one; ``mag_gauss`` is
    then zero.
    """

    time_us: int
    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3
    has_mag: bool


class RateSample(NamedTuple):
    """Body rates, FRD, of another message than the IMU's samples, less its sender's bias."""

    time_us: int
    rate_rad_s: Vec3


class Between(NamedTuple):
    """The turning between two samples, beside their own rates."""

    given: bool
    turn_rad_s: Vec3  # the constant rate that turns as far over the step, with the bias
    change_rad_s: Vec3  # root mean square of the changes from reading to reading
    step_s: float  # the longest time between two readings


# Times (us) before any and after any.
NEVER_US, EVER_US = -(1 << 62), 1 << 62
# Two readings further apart than this (s) do not show the turning between them.
UNSEEN_STEP_S = 0.35
NOTHING_BETWEEN = Between(False, ZERO_VEC3, ZERO_VEC3, 0.0)


class Sample(NamedTuple):
    """An :class:`ImuSample` for the filter's steps, with an interval in place of its time.

    The field may have any unit: that of the parameters that mention it (gauss).
    """

    gyr_rad_s: Vec3  # angular rate, FRD
    acc_m_s2: Vec3  # specific force, FRD
    mag: Vec3  # magnetic field, FRD; zero where there is none
    has_mag: bool  # whether there is a field
    dt_s: float  # since the sample before; 0 of the first one
    between: Between = NOTHING_BETWEEN  # compiled code has to name it


NO_SAMPLE = Sample(gyr_rad_s=ZERO_VEC3, acc_m_s2=ZERO_VEC3, mag=ZERO_VEC3, has_mag=False, dt_s=0.0)


class VelocitySample(NamedTuple):
    """Velocity over ground in NED, for the acceleration that hides gravity.

    ``has_vertical`` is False for sources of the horizontal part only. ``sigma_m_s`` is the source's
    own accuracy (1 sigma), or a typical one; ``late_sigma_s`` is that of ``time_us``, 0 if it is
    exact.
    """

    time_us: int
    velocity_ned_m_s: Vec3
    has_vertical: bool
    sigma_m_s: float
    late_sigma_s: float = 0.0


class Attitude(NamedTuple):
    """The estimator's output for ``time_us``.

    ``gain`` is the paper's K = 1 + k_op, ``error`` its e(R~) in [0, 1] from the measurements and
    ``error_rate_1_s`` the low-passed derivative. The sigmas are angles that 68 % of the errors lie
    under.
    """

    time_us: int
    q_ned_frd: Quaternion
    rate_rad_s: Vec3
    gyro_bias_rad_s: Vec3
    error: float
    error_rate_1_s: float
    gain: float
    confidence_gravity: float
    confidence_magnetic: float
    sigma_inclination_rad: float
    sigma_heading_rad: float
    heading_reference: str  # "true", "magnetic" or "none"


class VehicleClass(Enum):
    """What carries the IMU, as declared."""

    ANYTHING = auto()  # a hand, a robot's arm: quick turns, short accelerations, any gyroscope
    VEHICLE = auto()  # accelerates for long, and has the gyroscope of an autopilot
    WHEELS = auto()  # a vehicle that does not slip sideways: its velocity shows its heading
