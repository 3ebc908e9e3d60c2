"""How much a log's accelerometer vibrates, as ArduPilot's VIBE message measures it.

AP_InertialSensor takes a reading less its mean (low-passed at 5 Hz), squares it, low-passes that at
2 Hz and takes the root, axis by axis. ArduPilot's page "Measuring Vibration" gives the limits. An
autopilot's stream may be filtered before it is sent, so that its own VIBE is larger than this.
"""

from math import pi
from typing import Any, Literal

import msgspec
import numpy as np

from drivers.logs.percentile import percentile
from drivers.logs.spill_file import blocks
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
    step_s = percentile(trace.attitudes.steps_s, 50.0)
    if not 0.0 < step_s <= 1.0 / LEAST_RATE_HZ:
        return None
    parts = (trace.samples.column("acc_m_s2", rows) for rows in blocks(len(trace.samples)))
    found, mean, square = list[Floats](), _LowPass(MEAN_HZ, step_s), _LowPass(SQUARE_HZ, step_s)
    for acc in parts:
        found.append(np.sqrt(square((acc - mean(acc)) ** 2)))
    x, y, z = np.percentile(np.concatenate(found), PERCENT, axis=0).round(2).tolist()
    worst = max(x, y, z)
    verdict: Verdict = "usual" if worst < USUAL_M_S2 else "high"
    return Vibration((x, y, z), "too high" if worst > MOST_M_S2 else verdict)


class _LowPass:
    """A low-pass of first order over columns (N, 3) that come in parts; starts at the first row."""

    def __init__(self, cutoff_hz: float, step_s: float) -> None:
        self._share = step_s / (step_s + 1.0 / (2.0 * pi * cutoff_hz))
        self._state: Any = None

    def __call__(self, values: Floats) -> Floats:
        from scipy.signal import lfilter

        keep = 1.0 - self._share
        if self._state is None:
            self._state = keep * values[:1]
        passed, self._state = lfilter([self._share], [1.0, -keep], values, axis=0, zi=self._state)
        return np.asarray(passed)
