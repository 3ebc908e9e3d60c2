"""How far a long acceleration may have tilted the unaided stage's vertical.

That vertical is the mean force of some seconds, so it tilts by the mean acceleration over gravity.
The IMU feels this acceleration, seen through the aided attitude, and the reported velocity shows
it. A wrong attitude feels one that no report shows, and a receiver beside walls reports one that
nothing feels: the lesser of the two counts.
"""

from math import hypot

from estimator.aiding.inertial import GRAVITY_NED
from estimator.aiding.types import AccelerationTilt
from estimator.compilation.compiled import inlined
from estimator.conditioning.params import MOST_DEVIATION, ConditioningParams
from estimator.conditioning.vertical.lowpass import approach
from estimator.geometry.quaternion import add, scale, subtract
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3

# For so long the unaided stage averages.
ACCELERATION_TILT_TAU_S = ConditioningParams().gravity_tau_s
# A smaller acceleration (m/s^2) does not distinguish two attitudes.
LEAST_PUSH_M_S2 = 1.0


@inlined
def watch_acceleration_tilt(
    tilt: AccelerationTilt, force_ned_m_s2: Vec3, dt: float
) -> AccelerationTilt:
    """The means after one more sample."""
    share = dt / (ACCELERATION_TILT_TAU_S + dt)
    felt_m_s2 = approach(tilt.felt_m_s2, add(force_ned_m_s2, GRAVITY_NED), share)
    reported_m_s = approach(tilt.reported_m_s, tilt.latest_m_s, share)
    return AccelerationTilt(felt_m_s2, reported_m_s, tilt.latest_m_s)


@inlined
def acceleration_tilt_angle(tilt: AccelerationTilt, is_silent: bool, slow: float) -> float:
    """The tilt (rad); without reports it follows from the felt acceleration.

    On a ``slow`` stream without reports that acceleration is mostly the aided attitude's own error.
    """
    felt = tilt.felt_m_s2
    gained = subtract(tilt.latest_m_s, tilt.reported_m_s)
    push = hypot(felt[0], felt[1])
    if is_silent:
        return push / STANDARD_GRAVITY_M_S2 * (1.0 - slow)
    return min(push, hypot(gained[0], gained[1]) / ACCELERATION_TILT_TAU_S) / STANDARD_GRAVITY_M_S2


def explains_acceleration(tilt: AccelerationTilt) -> bool:
    """Whether the reports have accelerated as the aided attitude feels it, and clearly so.

    The unaided vertical is the mean force, which denies that the vehicle has accelerated at all. If
    the reports show that it has, the attitude that explains it is the better one, whatever a
    report's speed or the field shows. An attitude that is not a number explains nothing.
    """
    gained = subtract(tilt.latest_m_s, tilt.reported_m_s)
    seen = scale(1.0 / ACCELERATION_TILT_TAU_S, gained)
    left = subtract(tilt.felt_m_s2, seen)
    push = hypot(seen[0], seen[1])
    return push > LEAST_PUSH_M_S2 and hypot(left[0], left[1]) < MOST_DEVIATION * push
