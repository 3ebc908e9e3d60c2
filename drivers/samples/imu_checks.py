"""Checks on IMU data: no data at all, repeated fields, implausible magnitudes."""

import math
from collections import deque

from estimator.types import STANDARD_GRAVITY_M_S2, ZERO_VEC3, ImuSample, Vec3

REPEAT_US = 240_000  # autopilots repeat a 10 Hz field; equal values in a 4 Hz stream are data

SPACING_US = 200_000  # a window must outlast a flip or a fall, at any rate
WINDOW_SAMPLES = 50  # magnitudes are judged by their median over this many
FIRST_LOOK_SAMPLES = 20
ACC_AT_REST_G = (0.5, 2.0)
GYR_LIMIT_RAD_S = math.radians(2000.0)  # the range of common MEMS gyroscopes
MAG_RANGE_GAUSS = (0.05, 5.0)  # the Earth's is 0.25..0.65; scale and hard iron are often off

TRUSTED_AXES = (3, 12)  # MAV_AUTOPILOT ArduPilot and PX4: known to send FRD specific force


def refuse_imu(gyr: Vec3, acc: Vec3) -> str | None:
    """Why a reading is no data, as a word to count under; None if it is."""
    if not all(map(math.isfinite, gyr + acc)):
        return "not_finite"
    if acc == ZERO_VEC3:
        return "zero_accelerometer"
    return None


class MagMemory:
    """Tells a fresh magnetic field from an absent or a repeated one."""

    def __init__(self) -> None:
        self._last: Vec3 = ZERO_VEC3
        self._last_us = 0

    def fresh(self, mag: Vec3, time_us: int) -> Vec3 | None:
        """``mag``, or None if it is zero, not finite, or a repetition within 0.24 s."""
        if mag == ZERO_VEC3 or not all(map(math.isfinite, mag)):
            return None
        if mag == self._last and 0 <= time_us - self._last_us < REPEAT_US:
            return None
        self._last, self._last_us = mag, time_us
        return mag


class Plausibility:
    """Says once, in words, when an IMU's magnitudes cannot be right."""

    def __init__(self) -> None:
        # medians over the latest samples; the oldest is dropped
        self._acc_g: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._acc_z_g: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._gyr_rad_s: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._mag_gauss: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._seen = 0
        self._next_us = 0
        self._told: set[str] = set()

    def look(self, sample: ImuSample, autopilot: int | None) -> list[str]:
        """New complaints about the stream, each given once; usually none."""
        if 0 <= self._next_us - sample.time_us <= SPACING_US:
            return []
        self._next_us = sample.time_us + SPACING_US
        self._acc_g.append(math.hypot(*sample.acc_m_s2) / STANDARD_GRAVITY_M_S2)
        self._acc_z_g.append(sample.acc_m_s2[2] / STANDARD_GRAVITY_M_S2)
        self._gyr_rad_s.append(math.hypot(*sample.gyr_rad_s))
        if sample.has_mag:
            self._mag_gauss.append(math.hypot(*sample.mag_gauss))
        self._seen += 1
        if self._seen % WINDOW_SAMPLES != 0 and self._seen != FIRST_LOOK_SAMPLES:
            return []
        return self._new_complaints(autopilot)

    def _new_complaints(self, autopilot: int | None) -> list[str]:
        complaints = {
            "acc": self._acc_complaint(),
            "axes": self._axes_complaint(autopilot),
            "gyr": self._gyr_complaint(),
            "mag": self._mag_complaint(),
        }
        new = {key: text for key, text in complaints.items() if text and key not in self._told}
        self._told.update(new)
        return list(new.values())

    def _acc_complaint(self) -> str:
        low, high = ACC_AT_REST_G
        median = _median(self._acc_g)
        if low <= median <= high:
            return ""
        return f"accelerometer reads {median:.3g} g, expected about 1 g: wrong unit or scale?"

    def _axes_complaint(self, autopilot: int | None) -> str:
        if autopilot in TRUSTED_AXES or autopilot is None or _median(self._acc_z_g) < 0.5:
            return ""
        return "accelerometer z is positive: upside down, or an axis convention other than FRD"

    def _gyr_complaint(self) -> str:
        median = _median(self._gyr_rad_s)
        if median <= GYR_LIMIT_RAD_S:
            return ""
        return f"gyroscope reads {math.degrees(median):.3g} deg/s: wrong unit or scale?"

    def _mag_complaint(self) -> str:
        low, high = MAG_RANGE_GAUSS
        if len(self._mag_gauss) < FIRST_LOOK_SAMPLES // 4:
            return ""
        median = _median(self._mag_gauss)
        if low <= median <= high:
            return ""
        return f"magnetometer reads {median:.3g} gauss, expected about 0.5: wrong unit or scale?"


def _median(values: deque[float]) -> float:
    return sorted(values)[len(values) // 2]
