"""In a steady turn equal readings may be true.

In a circle flown without noise gyroscope and accelerometer read the same again and again. Equal
readings are those of a stuck sensor only where others contradict them: the field must turn as the
repeated rate says, and the axis of a steady turn must carry the vehicle's weight.
"""

from math import cos, sin

from estimator.geometry.quaternion import dot, norm, subtract
from estimator.types import STANDARD_GRAVITY_M_S2, Vec3

WEIGHT_M_S2 = 0.5  # from 1 g, of the force along the axis of a steady turn
FIELD_OFF = 0.17  # of the field's strength, that it may be elsewhere than the rate says
FIELD_OFF_SHARE = 0.5  # or so much of the way that the rate says: hard iron bends it
FIELD_LATE_S = 0.15  # magnetometers follow 0.1 s late, in steps
FIELD_WAY = 0.5  # of the field's strength: having gone so far as the rate says, it begins anew


def largest(v: Vec3) -> float:
    """The largest part of a vector, without its sign."""
    return max(abs(v[0]), abs(v[1]), abs(v[2]))


def apart_rad(one: Vec3, other: Vec3) -> float:
    """About the angle between two directions, up to 2 for opposite ones; 0 if one is no vector."""
    a, b = norm(one), norm(other)
    if a == 0.0 or b == 0.0:
        return 0.0
    x, y, z = one[0] / a - other[0] / b, one[1] / a - other[1] / b, one[2] / a - other[2] / b
    return norm((x, y, z))


def field_contradicts(
    before_gauss: Vec3, mag_gauss: Vec3, gyr_rad_s: Vec3, span_s: float
) -> tuple[bool, bool]:
    """Whether a field is not where the rate has turned it in a time; whether it is well on its way.

    Then it is to be watched from here on.
    """
    strength = norm(before_gauss)
    expected = vector_after_turn(before_gauss, gyr_rad_s, span_s)
    way = norm(subtract(expected, before_gauss)) / strength
    off = norm(subtract(expected, mag_gauss)) / strength
    allowed = max(FIELD_OFF + FIELD_LATE_S * norm(gyr_rad_s), FIELD_OFF_SHARE * way)
    return off > allowed, way >= FIELD_WAY


def carries_weight(acc_m_s2: Vec3, gyr_rad_s: Vec3) -> bool:
    """Whether the force is that of a turn that may go on for ever, as it is and at that rate.

    In the mean over the turn its part along the axis is left, and must hold the vehicle up.
    """
    rate_rad_s = norm(gyr_rad_s)
    if rate_rad_s == 0.0:
        return False
    along = dot(acc_m_s2, gyr_rad_s) / rate_rad_s
    return abs(abs(along) - STANDARD_GRAVITY_M_S2) <= WEIGHT_M_S2


def vector_after_turn(vector: Vec3, gyr_rad_s: Vec3, span_s: float) -> Vec3:
    """A body vector of something fixed, after turning at that rate (Rodrigues, by -w t)."""
    rate_rad_s = norm(gyr_rad_s)
    if rate_rad_s == 0.0:
        return vector
    x, y, z = gyr_rad_s[0] / rate_rad_s, gyr_rad_s[1] / rate_rad_s, gyr_rad_s[2] / rate_rad_s
    a, b, c = vector
    sine, cosine = sin(rate_rad_s * span_s), cos(rate_rad_s * span_s)
    along = (1.0 - cosine) * (x * a + y * b + z * c)
    return (
        cosine * a + sine * (b * z - c * y) + along * x,
        cosine * b + sine * (c * x - a * z) + along * y,
        cosine * c + sine * (a * y - b * x) + along * z,
    )
