"""What ``fuzzbee check`` finds in one log: differences of attitudes, vibration, clipping, warnings.

ArduPilot's VIBE message measures vibration so: a reading less its mean (low-passed at 5 Hz) is
squared, low-passed at 2 Hz, and the root taken, axis by axis. ArduPilot's page "Measuring
Vibration" gives the limits. A stream may be filtered before it is sent, and so vibrate less.
"""

from math import pi
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from estimator.arrays import Floats
from estimator.errors import InputError
from estimator.profile import load_profile
from estimator.reasons import Reason
from fuzzbee.replays.log_report import differences_of, refused_text, replay_log, verdicts
from fuzzbee.replays.trace import How, VehicleTrace
from service.alarms import Alarm

CLIPPED = {
    "accelerometer": Reason.ACCELEROMETER_SATURATED,
    "gyroscope": Reason.GYROSCOPE_SATURATED,
}
DIFFERS = Alarm.AUTOPILOT_DIFFERS  # the differences tell more
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


class Checked(NamedTuple):
    """What was found in one log, or why it cannot be read.

    ``clipped`` counts readings at the end of a sensor's range, ``warnings`` the seconds for which
    each warning stood (docs/troubleshooting.md). ``vibration`` is None below 20 Hz. ``refused``
    says what was refused of a log that lost much to it.
    """

    log: str
    agreement: dict[str, int]
    differences: list[dict[str, Any]]
    fault: str
    vibration: Vibration | None = None
    clipped: dict[str, int] = {}  # noqa: RUF012 - never changed
    warnings: dict[str, float] = {}  # noqa: RUF012 - never changed
    refused: str = ""

    @property
    def rank(self) -> tuple[bool, float, float]:
        """The larger, the worse."""
        seconds = sum(each["end_s"] - each["begin_s"] for each in self.differences)
        return bool(self.differences), seconds, sum(self.warnings.values())


def check_log(path: Path, profile: str, window: TimeWindow = WHOLE_LOG) -> Checked:
    """Replay a log; what cannot be read is said in its own line."""
    try:
        trace = replay_log(path, load_profile(profile), How(window=window))
    except InputError as error:
        return Checked(str(path), {}, [], str(error))
    found = [msgspec.to_builtins(each) for each in differences_of(trace)]
    counts = {sensor: trace.rejected[reason] for sensor, reason in CLIPPED.items()}
    clipped = {sensor: count for sensor, count in counts.items() if count}
    warned_s = {word: round(s, 1) for word, s in trace.warned_s.items() if word != DIFFERS}
    return Checked(
        str(path),
        verdicts(trace),
        found,
        "",
        vibration(trace),
        clipped,
        dict(sorted(warned_s.items())),
        refused_text(trace) or "",
    )


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
