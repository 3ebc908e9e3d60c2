"""What no sensor can read, and magnitudes and axes that cannot be right, told in words."""

import math
from collections import deque
from typing import NamedTuple

from estimator.live.refusal import ACC_LIMIT_M_S2, RATE_LIMIT_RAD_S
from estimator.reasons import Reason
from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, ImuSample, Vec3

MAG_LIMIT_GAUSS = 8.0  # ten times the Earth's field and more; common magnetometers end there
LATITUDE_DEG, LONGITUDE_DEG = 90.0, 180.0
ALTITUDES_M = (-12_000.0, 1_000_000.0)  # from the deepest sea to space

SPACING_US = 200_000  # a window must outlast a flip or a fall, at any rate
WINDOW_SAMPLES = 50  # magnitudes are judged by their median over this many
FIRST_LOOK_SAMPLES, LEAST_SAMPLES = 20, 5
UNIT_LIMIT_GAUSS = 1e6  # no field in another unit, but a number that stands for none

AXES_COMPLAINT = (
    "accelerometer z is positive: upside down, or axes other than FRD. If it stands level, write "
    "into the profile: [mounting] acc_sign = -1 (or rotation_deg = [180, 0, 0] if y and z of the "
    "gyroscope are the other way round, too)"
)


class Usual(NamedTuple):
    """Where a median usually is, and what is said of another."""

    low: float
    high: float
    complaint: str


WRONG_UNIT = "wrong unit or scale?"
USUAL = {
    "force": Usual(0.5, 2.0, f"accelerometer reads {{:.3g}} g, expected about 1 g: {WRONG_UNIT}"),
    # z, which is about -1 g where axes are FRD
    "axes": Usual(-math.inf, 0.5, AXES_COMPLAINT),
    # the range of common MEMS gyroscopes
    "rate": Usual(0.0, 2000.0, f"gyroscope reads {{:.3g}} deg/s: {WRONG_UNIT}"),
    # the Earth's is 0.25 to 0.65; scale and hard iron are often off
    "field": Usual(
        0.05, 5.0, f"magnetometer reads {{:.3g}} gauss, expected about 0.5: {WRONG_UNIT}"
    ),
}


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
        # the latest of each, of which the median counts
        self._latest = {name: deque[float](maxlen=WINDOW_SAMPLES) for name in USUAL}
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
        latest, acc = self._latest, sample.acc_m_s2
        latest["force"].append(math.hypot(*acc) / STANDARD_GRAVITY_M_S2)
        latest["axes"].append(acc[2] / STANDARD_GRAVITY_M_S2)
        latest["rate"].append(math.degrees(math.hypot(*sample.gyr_rad_s)))
        if field is not None and _is_below(field, UNIT_LIMIT_GAUSS):
            latest["field"].append(math.hypot(*field))
        self._seen += 1
        if self._seen % WINDOW_SAMPLES != 0 and self._seen != FIRST_LOOK_SAMPLES:
            return []
        found = {
            name: usual.complaint.format(median)
            for name, usual in USUAL.items()
            if len(latest[name]) >= LEAST_SAMPLES and (doubts_axes or name != "axes")
            if not usual.low
            <= (median := sorted(latest[name])[len(latest[name]) // 2])
            < usual.high
        }
        new = [text for name, text in found.items() if name not in self._told]
        self._told |= found.keys()
        return new
