"""How much a log's accelerometer vibrates, as ArduPilot's VIBE message measures it.

AP_InertialSensor takes a reading less its mean (low-passed at 5 Hz), squares it, low-passes that at
2 Hz and takes the root, axis by axis. ArduPilot's page "Measuring Vibration" gives the limits. An
autopilot's stream may be filtered before it is sent, so that its own VIBE is larger than this.
"""

from math import pi
from typing import Literal

import msgspec
import numpy as np

from estimator.arrays import Floats
from fuzzbee.replays.trace import VehicleTrace

MEAN_HZ, SQUARE_HZ = 5.0, 2.0
USUAL_M_S2, MOST_M_S2 = 30.0, 60.0  # below it is usual, above it nearly always a problem
LEAST_RATE_HZ = 20.0  # a slower stream does not show what the mean is
PERCENT = 95.0  # of the time it is no larger

Verdict = Literal["usual", "high", "too high"]


class Vibration(msgspec.Struct, frozen=True):
    """Vibration along each body axis in m/s^2, which is exceeded for 5 % of the time."""

    m_s2: tuple[float, float, float]
    verdict: Verdict

    @property
    def largest_m_s2(self) -> float:
        """That of the worst axis."""
        return max(self.m_s2)


def vibration(trace: VehicleTrace) -> Vibration | None:
    """The vibration of a replayed log; None where the IMU's stream is too slow to show it."""
    steps_s = 1e-6 * np.diff(trace["time_us"])
    step_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    if not 0.0 < step_s <= 1.0 / LEAST_RATE_HZ:
        return None
    sizes = []
    for acc in trace["acc_m_s2"].T:
        square = _low_pass((acc - _low_pass(acc, MEAN_HZ, step_s)) ** 2, SQUARE_HZ, step_s)
        sizes.append(round(float(np.percentile(np.sqrt(square), PERCENT)), 2))
    x, y, z = sizes
    verdict: Verdict = "usual" if max(sizes) < USUAL_M_S2 else "high"
    return Vibration((x, y, z), "too high" if max(sizes) > MOST_M_S2 else verdict)


def _low_pass(values: Floats, cutoff_hz: float, step_s: float) -> Floats:
    """A low-pass of first order over values (N,); starts at the first."""
    from scipy.signal import lfilter

    share = step_s / (step_s + 1.0 / (2.0 * pi * cutoff_hz))
    start = [(1.0 - share) * values[0]]
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, zi=start)[0])
