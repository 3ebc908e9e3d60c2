"""In a steady turn equal readings may be true.

In a circle flown without noise gyroscope and accelerometer read the same again and again. Equal
readings are those of a stuck sensor only where others contradict them: the field must turn as the
repeated rate says, and the axis of a steady turn must carry the vehicle's weight.
"""

from math import cos, dist, hypot, sin

from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

WEIGHT_M_S2 = 0.5  # from 1 g, of the force along the axis of a steady turn
FIELD_OFF = 0.17  # of the field's strength, that it may be elsewhere than the rate says
FIELD_OFF_SHARE = 0.5  # or so much of the way that the rate says: hard iron bends it
FIELD_LATE_S = 0.15  # magnetometers follow 0.1 s late, in steps
FIELD_WAY = 0.5  # of the field's strength: having gone so far as the rate says, it begins anew


class FieldWatch:
    """Whether the field turns as a repeated rate says, since the repetition began."""

    def __init__(self) -> None:
        self._mag_gauss = ZERO_VEC3
        self._begin_us = 0

    @property
    def begun(self) -> tuple[Vec3, int]:
        """The field at the beginning, and when that was."""
        return self._mag_gauss, self._begin_us

    def begin(self, mag_gauss: Vec3, raw_us: int) -> None:
        """Look from here on."""
        self._mag_gauss, self._begin_us = mag_gauss, raw_us

    def knows(self, mag_gauss: Vec3) -> bool:
        """Whether there is a field to look at."""
        return ZERO_VEC3 not in (mag_gauss, self._mag_gauss)

    def contradicts(self, mag_gauss: Vec3, gyr_rad_s: Vec3, raw_us: int) -> bool:
        """Whether the field of a reading is not where the rate ``gyr_rad_s`` has turned it."""
        before, strength = self._mag_gauss, hypot(*self._mag_gauss)
        span_s = 1e-6 * max(raw_us - self._begin_us, 0)  # the clock may have begun anew
        expected = vector_after_turn(before, gyr_rad_s, span_s)
        way, off = dist(expected, before) / strength, dist(expected, mag_gauss) / strength
        allowed = max(FIELD_OFF + FIELD_LATE_S * hypot(*gyr_rad_s), FIELD_OFF_SHARE * way)
        if off > allowed:
            return True
        if way >= FIELD_WAY:
            self.begin(mag_gauss, raw_us)
        return False


def carries_weight(acc_m_s2: Vec3, gyr_rad_s: Vec3) -> bool:
    """Whether the force is that of a turn that may go on for ever, as it is and at that rate.

    In the mean over the turn its part along the axis is left, and must hold the vehicle up.
    """
    rate_rad_s = hypot(*gyr_rad_s)
    if rate_rad_s == 0.0:
        return False
    along = sum(f * w for f, w in zip(acc_m_s2, gyr_rad_s, strict=True)) / rate_rad_s
    return abs(abs(along) - STANDARD_GRAVITY_M_S2) <= WEIGHT_M_S2


def vector_after_turn(vector: Vec3, gyr_rad_s: Vec3, span_s: float) -> Vec3:
    """A body vector of something fixed, after turning at that rate (Rodrigues, by -w t)."""
    rate_rad_s = hypot(*gyr_rad_s)
    if rate_rad_s == 0.0:
        return vector
    x, y, z = (each / rate_rad_s for each in gyr_rad_s)
    a, b, c = vector
    sine, cosine = sin(rate_rad_s * span_s), cos(rate_rad_s * span_s)
    along = (1.0 - cosine) * (x * a + y * b + z * c)
    return (
        cosine * a + sine * (b * z - c * y) + along * x,
        cosine * b + sine * (c * x - a * z) + along * y,
        cosine * c + sine * (a * y - b * x) + along * z,
    )
