"""Magnitudes and axes of an IMU that cannot be right, told in words."""

import math
from collections import deque

from estimator.types import STANDARD_GRAVITY_M_S2, ImuSample

SPACING_US = 200_000  # a window must outlast a flip or a fall, at any rate
WINDOW_SAMPLES = 50  # magnitudes are judged by their median over this many
FIRST_LOOK_SAMPLES = 20
ACC_AT_REST_G = (0.5, 2.0)
GYR_RANGE_RAD_S = math.radians(2000.0)  # the range of common MEMS gyroscopes
MAG_RANGE_GAUSS = (0.05, 5.0)  # the Earth's is 0.25..0.65; scale and hard iron are often off
UPWARD_G = 0.5  # of an accelerometer's z, which is about -1 g where axes are FRD

WRONG_UNIT = "wrong unit or scale?"
AXES_COMPLAINT = (
    "accelerometer z is positive: upside down, or axes other than FRD. If it stands level, write "
    "into the profile: [mounting] acc_sign = -1 (or rotation_deg = [180, 0, 0] if y and z of the "
    "gyroscope are the other way round, too)"
)


class Plausibility:
    """Says once, in words, when an IMU's magnitudes cannot be right."""

    def __init__(self) -> None:
        # medians over the latest samples; the oldest is dropped
        self._acc_g: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._acc_z_g: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._gyr_rad_s: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._mag_gauss: deque[float] = deque(maxlen=WINDOW_SAMPLES)
        self._seen = 0
        self.next_us = 0  # when to look next
        self._told: set[str] = set()

    def look(self, sample: ImuSample, *, doubts_axes: bool) -> list[str]:
        """New complaints about the stream, each given once; usually none.

        ``doubts_axes``: the sender is not known for sending FRD.
        """
        if 0 <= self.next_us - sample.time_us <= SPACING_US:
            return []
        return self.look_now(sample, doubts_axes=doubts_axes)

    def look_now(self, sample: ImuSample, *, doubts_axes: bool) -> list[str]:
        """As :meth:`look`, where it is known to be time."""
        self.next_us = sample.time_us + SPACING_US
        self._acc_g.append(math.hypot(*sample.acc_m_s2) / STANDARD_GRAVITY_M_S2)
        self._acc_z_g.append(sample.acc_m_s2[2] / STANDARD_GRAVITY_M_S2)
        self._gyr_rad_s.append(math.hypot(*sample.gyr_rad_s))
        if sample.has_mag:
            self._mag_gauss.append(math.hypot(*sample.mag_gauss))
        self._seen += 1
        if self._seen % WINDOW_SAMPLES != 0 and self._seen != FIRST_LOOK_SAMPLES:
            return []
        return self._new_complaints(doubts_axes=doubts_axes)

    def _new_complaints(self, *, doubts_axes: bool) -> list[str]:
        acc_g, gyr_rad_s = _median(self._acc_g), _median(self._gyr_rad_s)
        complaints = []
        if not _is_within(acc_g, ACC_AT_REST_G):
            complaints.append(
                ("acc", f"accelerometer reads {acc_g:.3g} g, expected about 1 g: {WRONG_UNIT}")
            )
        if doubts_axes and not _median(self._acc_z_g) < UPWARD_G:
            complaints.append(("axes", AXES_COMPLAINT))
        if not gyr_rad_s <= GYR_RANGE_RAD_S:
            rate_deg_s = math.degrees(gyr_rad_s)
            complaints.append(("gyr", f"gyroscope reads {rate_deg_s:.3g} deg/s: {WRONG_UNIT}"))
        if len(self._mag_gauss) >= FIRST_LOOK_SAMPLES // 4:
            mag_gauss = _median(self._mag_gauss)
            if not _is_within(mag_gauss, MAG_RANGE_GAUSS):
                text = f"magnetometer reads {mag_gauss:.3g} gauss, expected about 0.5: {WRONG_UNIT}"
                complaints.append(("mag", text))
        new = [(sensor, text) for sensor, text in complaints if sensor not in self._told]
        self._told.update(sensor for sensor, _ in new)
        return [text for _, text in new]


def _is_within(value: float, span: tuple[float, float]) -> bool:
    return span[0] <= value <= span[1]


def _median(values: deque[float]) -> float:
    return sorted(values)[len(values) // 2]
