"""Sensors that repeat themselves or have reached the end of their range.

Both give numbers that look like data and are none. Real sensors are noisy: equal
readings, one after the other, come from a driver that has stopped reading, and an
equal large value on one axis is the end of a range. Simulators know rest without
noise: so equal readings are refused only if they, or the magnetometer, speak of motion.
"""

from math import dist, hypot
from typing import NamedTuple

from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, Vec3

# The messages' 16-bit fields end here: 32.767 rad/s and g
GYR_END_RAD_S = 32.767
ACC_END_M_S2 = 32.767 * STANDARD_GRAVITY_M_S2
# The ranges of common IMUs begin at 250 deg/s and 4 g; below that, equal values are no rail
GYR_RAIL_RAD_S = 4.3
ACC_RAIL_M_S2 = 3.9 * STANDARD_GRAVITY_M_S2
RAIL_SAMPLES = 4

STUCK_SAMPLES = 20  # equal readings of gyroscope and accelerometer
STUCK_US = 500_000
# What no vehicle at rest shows: more than a gyroscope's bias, not 1 g, a field that turns
MOVING_GYR_RAD_S = 0.05
MOVING_ACC_M_S2 = 0.5
MOVING_MAG = 0.17  # of the field's strength: 10 degrees
NOISY_SAMPLES = 50  # that many changes before prove that the sensor has noise
MAG_STUCK_SAMPLES = 20
MAG_STUCK_US = 2_000_000
MAG_TURN_RAD = 0.5  # turned so far, the field cannot be what it was


class Readings(NamedTuple):
    """One IMU message's vectors."""

    gyr_rad_s: Vec3
    acc_m_s2: Vec3
    mag_gauss: Vec3


class SensorFaults:
    """Follows one IMU stream; bounded, a few numbers."""

    def __init__(self) -> None:
        self._last = Readings(ZERO_VEC3, ZERO_VEC3, ZERO_VEC3)
        self._changes = 0
        self._equal = 0
        self._equal_since_us = 0
        self._equal_mag = ZERO_VEC3
        self._rails = [0] * 6
        self._axis_changes = [0] * 6
        self._last_us = 0
        self._mag_changes = 0
        self._mag_equal = 0
        self._mag_since_us = 0
        self._mag_turn_rad = 0.0

    def refusal(self, readings: Readings, raw_us: int) -> str | None:
        """Why a reading at ``raw_us`` on the vehicle's clock is no data; None if it is."""
        stuck = self._is_stuck(readings, raw_us)
        saturated = self._saturated(readings)
        self._follow_mag(readings, raw_us)
        self._last, self._last_us = readings, raw_us
        if saturated is not None:
            return saturated
        return "stuck" if stuck else None

    @property
    def mag_is_stuck(self) -> bool:
        """Whether the field of the last reading has not followed the vehicle's turning."""
        return (
            self._mag_equal >= MAG_STUCK_SAMPLES
            and self._mag_changes >= NOISY_SAMPLES
            and self._last_us - self._mag_since_us >= MAG_STUCK_US
            and self._mag_turn_rad >= MAG_TURN_RAD
        )

    def _is_stuck(self, readings: Readings, raw_us: int) -> bool:
        if readings[:2] != self._last[:2]:
            self._changes = min(self._changes + 1, NOISY_SAMPLES)
            self._equal, self._equal_since_us = 0, raw_us
            self._equal_mag = readings.mag_gauss
            return False
        self._equal += 1
        self._equal_since_us = min(self._equal_since_us, raw_us)
        long_enough = raw_us - self._equal_since_us >= STUCK_US
        if self._changes < NOISY_SAMPLES or self._equal < STUCK_SAMPLES or not long_enough:
            return False
        return _moves(readings, self._equal_mag)

    def _saturated(self, readings: Readings) -> str | None:
        found = None
        axes = (*readings.gyr_rad_s, *readings.acc_m_s2)
        before = (*self._last.gyr_rad_s, *self._last.acc_m_s2)
        for axis, (value, last) in enumerate(zip(axes, before, strict=True)):
            is_gyr = axis < 3
            size = abs(value)
            at_rail = value == last and size >= (GYR_RAIL_RAD_S if is_gyr else ACC_RAIL_M_S2)
            self._rails[axis] = self._rails[axis] + 1 if at_rail else 0
            if value != last:
                self._axis_changes[axis] = min(self._axis_changes[axis] + 1, NOISY_SAMPLES)
            is_noisy = self._axis_changes[axis] >= NOISY_SAMPLES
            end = GYR_END_RAD_S if is_gyr else ACC_END_M_S2
            at_end = (1 - 1e-9) * end <= size <= (1 + 1e-4) * end  # -32768 is further than 32767
            if at_end or (is_noisy and self._rails[axis] >= RAIL_SAMPLES):
                found = "gyroscope_saturated" if is_gyr else "accelerometer_saturated"
        return found

    def _follow_mag(self, readings: Readings, raw_us: int) -> None:
        if readings.mag_gauss != self._last.mag_gauss or readings.mag_gauss == ZERO_VEC3:
            self._mag_changes = min(self._mag_changes + 1, NOISY_SAMPLES)
            self._mag_equal, self._mag_since_us, self._mag_turn_rad = 0, raw_us, 0.0
            return
        self._mag_equal += 1
        step_s = 1e-6 * min(max(raw_us - self._last_us, 0), MAG_STUCK_US)
        self._mag_turn_rad += step_s * max(map(abs, readings.gyr_rad_s))


def _moves(readings: Readings, mag_before: Vec3) -> bool:
    """Whether the readings cannot be those of a vehicle at rest."""
    if max(map(abs, readings.gyr_rad_s)) > MOVING_GYR_RAD_S:
        return True
    if abs(hypot(*readings.acc_m_s2) - STANDARD_GRAVITY_M_S2) > MOVING_ACC_M_S2:
        return True
    if ZERO_VEC3 in (readings.mag_gauss, mag_before):
        return False
    return dist(readings.mag_gauss, mag_before) > MOVING_MAG * hypot(*mag_before)
