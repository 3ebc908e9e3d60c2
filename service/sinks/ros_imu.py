"""A published attitude as the bytes of a ROS 2 ``sensor_msgs/msg/Imu``. No I/O and no clock.

Frames change from NED/FRD to ENU/FLU (REP 103) through ``estimator/geometry/frames.py``.
The fields: https://docs.ros.org/en/jazzy/p/sensor_msgs/msg/Imu.html.
"""

from math import log, radians, sqrt

from estimator.geometry.frames import enu_flu_from_ned_frd, flu_from_frd
from estimator.types import ZERO_VEC3, Vec3
from service.records import AttitudeRecord
from service.sinks.cdr import CdrWriter

TYPE_NAME = "sensor_msgs::msg::dds_::Imu_"
# REP 2016's hash of the type's definition; the same in Humble, Jazzy and Kilted
TYPE_HASH = "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"

# The inclination's error has two components. If each is normal with deviation s, their
# length is Rayleigh distributed: 68 % of it lies under s sqrt(-2 ln 0.32) = 1.51 s.
INCLINATION_BOUND_PER_AXIS = sqrt(-2.0 * log(0.32))
# The heading's error has one component: 68 % of its size lies under 0.99 s, taken as s here.

# By the message's definition: a covariance that is unknown, and a quantity without any value
UNKNOWN_COVARIANCE = (0.0,) * 9
NO_VALUE = (-1.0, *(0.0,) * 8)


def imu_message(record: AttitudeRecord, acc_frd_m_s2: Vec3 | None, frame_id: str) -> bytes:
    """The message at the record's time.

    ``acc_frd_m_s2`` is the specific force, which ROS calls linear acceleration
    (at rest it points up); without it the message says so.
    """
    w, x, y, z = enu_flu_from_ned_frd(record.q_ned_frd)
    out = CdrWriter()
    out.put_stamp(record.time_unix_us)
    out.put_text(frame_id)
    out.put_numbers(
        *(x, y, z, w),
        *orientation_covariance(record),
        *flu_from_frd(record.rate_rad_s),
        *UNKNOWN_COVARIANCE,
        *flu_from_frd(ZERO_VEC3 if acc_frd_m_s2 is None else acc_frd_m_s2),
        *(NO_VALUE if acc_frd_m_s2 is None else UNKNOWN_COVARIANCE),
    )
    return out.message


def orientation_covariance(record: AttitudeRecord) -> tuple[float, ...]:
    """Row-major 3x3 (rad^2) about the fixed axes east, north and up, from the estimate's sigmas."""
    inclination = (radians(record.sigma_deg.inclination) / INCLINATION_BOUND_PER_AXIS) ** 2
    heading = radians(record.sigma_deg.heading) ** 2
    return (inclination, 0.0, 0.0, 0.0, inclination, 0.0, 0.0, 0.0, heading)
