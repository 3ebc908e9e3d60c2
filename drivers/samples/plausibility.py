"""What no sensor can read, and magnitudes and axes that cannot be right, told in words."""

import math
from collections import deque

from estimator.live.refusal import ACC_LIMIT_M_S2, RATE_LIMIT_RAD_S
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, ImuSample, Vec3

MAG_LIMIT_GAUSS = 8.0  # ten times the Earth's field and more; common magnetometers end there
LATITUDE_DEG, LONGITUDE_DEG = 90.0, 180.0
ALTITUDES_M = (-12_000.0, 1_000_000.0)  # from the deepest sea to space

SPACING_US = 200_000  # a window must outlast a flip or a fall, at any rate
WINDOW_SAMPLES = 50  # magnitudes are judged by their median over this many
FIRST_LOOK_SAMPLES = 20
ACC_AT_REST_G = (0.5, 2.0)
GYR_RANGE_RAD_S = math.radians(2000.0)  # the range of common MEMS gyroscopes
MAG_RANGE_GAUSS = (0.05, 5.0)  # the Earth's is 0.25..0.65; scale and hard iron are often off
UNIT_LIMIT_GAUSS = 1e6  # no field in another unit, but a number that stands for none
UPWARD_G = 0.5  # of an accelerometer's z, which is about -1 g where axes are FRD

WRONG_UNIT = "wrong unit or scale?"
AXES_COMPLAINT = (
    "accelerometer z is positive: upside down, or axes other than FRD. If it stands level, write "
    "into the profile: [mounting] acc_sign = -1 (or rotation_deg = [180, 0, 0] if y and z of the "
    "gyroscope are the other way round, too)"
)


def imu_refusal(gyr_rad_s: Vec3, acc_m_s2: Vec3) -> Reason | None:
    """Why a reading is no data whatever came before it; None if it is."""
    if not all(map(math.isfinite, gyr_rad_s + acc_m_s2)):
        return Reason.NOT_FINITE
    if not _is_below(gyr_rad_s, RATE_LIMIT_RAD_S):
        return Reason.GYROSCOPE_OUT_OF_RANGE
    if not _is_below(acc_m_s2, ACC_LIMIT_M_S2):
        return Reason.ACCELEROMETER_OUT_OF_RANGE
    return Reason.ZERO_ACCELEROMETER if acc_m_s2 == ZERO_VEC3 else None


def is_field(mag_gauss: Vec3) -> bool:
    """Whether a finite reading can be one of a magnetometer."""
    return _is_below(mag_gauss, MAG_LIMIT_GAUSS)


def is_place(position: Vec3) -> bool:
    """Whether latitude and longitude (degrees) and altitude (m) are those of a place."""
    latitude_deg, longitude_deg, altitude_m = position
    is_on_earth = abs(latitude_deg) <= LATITUDE_DEG and abs(longitude_deg) <= LONGITUDE_DEG
    return is_on_earth and ALTITUDES_M[0] <= altitude_m <= ALTITUDES_M[1]


def _is_below(vector: Vec3, most: float) -> bool:
    x, y, z = vector
    return -most <= x <= most and -most <= y <= most and -most <= z <= most


class Plausibility:
    """Says once, in words, when an IMU's magnitudes cannot be right."""

    def __init__(self) -> None:
        # medians over the latest samples; the oldest is dropped
        self._acc_g: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._acc_z_g: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._gyr_rad_s: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._mag_gauss: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._seen = 0
        self._next_us = 0  # when to look next
        self._told: set[str] = set()

    def look(self, sample: ImuSample, field: Vec3 | None, *, doubts_axes: bool) -> list[str]:
        """New complaints about the stream, each given once; usually none.

        ``field`` is the new magnetic field beside the sample, used or refused. ``doubts_axes``:
        the sender is not known for sending FRD.
        """
        if 0 <= self._next_us - sample.time_us <= SPACING_US:
            return []
        self._next_us = sample.time_us + SPACING_US
        self._acc_g.append(math.hypot(*sample.acc_m_s2) / STANDARD_GRAVITY_M_S2)
        self._acc_z_g.append(sample.acc_m_s2[2] / STANDARD_GRAVITY_M_S2)
        self._gyr_rad_s.append(math.hypot(*sample.gyr_rad_s))
        if field is not None and _is_below(field, UNIT_LIMIT_GAUSS):
            self._mag_gauss.append(math.hypot(*field))
        self._seen += 1
        if self._seen % WINDOW_SAMPLES != 0 and self._seen != FIRST_LOOK_SAMPLES:
            return []
        found = self._complaints(doubts_axes=doubts_axes)
        new = [text for sensor, text in found.items() if sensor not in self._told]
        self._told |= found.keys()
        return new

    def _complaints(self, *, doubts_axes: bool) -> dict[str, str]:
        acc_g, gyr_rad_s, found = _median(self._acc_g), _median(self._gyr_rad_s), {}
        if not ACC_AT_REST_G[0] <= acc_g <= ACC_AT_REST_G[1]:
            found["acc"] = f"accelerometer reads {acc_g:.3g} g, expected about 1 g: {WRONG_UNIT}"
        if doubts_axes and not _median(self._acc_z_g) < UPWARD_G:
            found["axes"] = AXES_COMPLAINT
        if not gyr_rad_s <= GYR_RANGE_RAD_S:
            rate_deg_s = math.degrees(gyr_rad_s)
            found["gyr"] = f"gyroscope reads {rate_deg_s:.3g} deg/s: {WRONG_UNIT}"
        if len(self._mag_gauss) >= FIRST_LOOK_SAMPLES // 4:
            gauss = _median(self._mag_gauss)
            if not MAG_RANGE_GAUSS[0] <= gauss <= MAG_RANGE_GAUSS[1]:
                text = f"magnetometer reads {gauss:.3g} gauss, expected about 0.5: {WRONG_UNIT}"
                found["mag"] = text
        return found


def _median(values: deque[float]) -> float:
    return sorted(values)[len(values) // 2]
