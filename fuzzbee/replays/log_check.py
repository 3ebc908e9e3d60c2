"""What ``fuzzbee check`` finds in one log: differences of attitudes, vibration, clipping, warnings.

ArduPilot's VIBE message measures vibration so: a reading less its mean (low-passed at 5 Hz) is
squared, low-passed at 2 Hz, and the root taken, axis by axis. ArduPilot's page "Measuring
Vibration" gives the limits. A stream may be filtered before it is sent, and so vibrate less: what
the autopilot has measured stands beside it.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator
from math import isfinite, pi
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from drivers.logs.other_sensors import vibrations
from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from estimator.errors import InputError
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import Floats, Vec3
from fuzzbee.notify import printable
from fuzzbee.replays.report import DifferenceSummary
from fuzzbee.replays.score import by_name, differences_of, verdicts
from fuzzbee.replays.table import difference_text
from fuzzbee.replays.trace import How, VehicleTrace, replay_log
from service.alarms import Alarm

CLIPPED = {
    "accelerometer": Reason.ACCELEROMETER_SATURATED,
    "gyroscope": Reason.GYROSCOPE_SATURATED,
}
DIFFERS = Alarm.AUTOPILOT_DIFFERS  # which the differences show better
MEAN_HZ, SQUARE_HZ = 5.0, 2.0
USUAL_M_S2, MOST_M_S2 = 30.0, 60.0  # below it is usual, above it nearly always a problem
USUAL_CLIPS = 100  # fewer are those of a hard landing
LEAST_RATE_HZ = 20.0  # a slower stream does not show what the mean is
PERCENT = 95.0  # of the time it is no larger

Verdict = Literal["usual", "high", "too high"]


class Vibration(msgspec.Struct, frozen=True):
    """Vibration along each body axis in m/s^2, which is exceeded for 5 % of the time."""

    m_s2: Vec3
    verdict: Verdict


class OwnVibration(msgspec.Struct, frozen=True):
    """What the autopilot has measured itself."""

    message: str  # by which it reports that
    imu: int  # the one that vibrates most
    m_s2: Vec3 | None  # as in Vibration, of that IMU; None where the message has none
    verdict: Verdict | None
    clipped: dict[int, int]  # how often in the log, by IMU from 0


class Checked(msgspec.Struct, frozen=True):
    """What was found in one log."""

    log: str
    agreement: dict[str, int] = {}
    differences: list[DifferenceSummary] = []
    fault: str = ""  # why it cannot be read
    vibration: Vibration | None = None  # None below 20 Hz
    clipped: dict[str, int] = {}  # readings at the end of a sensor's range
    warnings: dict[str, float] = {}  # for how many seconds each stood (docs/troubleshooting.md)
    refused: str = ""  # a line, if much was
    autopilot_vibration: OwnVibration | None = None  # None without VIBE or VIBRATION

    @property
    def rank(self) -> tuple[bool, float, float]:
        """The larger, the worse."""
        seconds = sum(each.end_s - each.begin_s for each in self.differences)
        return bool(self.differences), seconds, sum(self.warnings.values())


def check_log(path: Path, profile: Profile, window: TimeWindow) -> Checked:
    """Replay a log; one that cannot be read has its reason as ``fault``."""
    try:
        trace = replay_log(path, profile, How(window=window))
    except InputError as error:
        return Checked(str(path), fault=str(error))
    warned_s = {word: round(s, 1) for word, s in trace.warned_s.items() if word != DIFFERS}
    return Checked(
        str(path),
        verdicts(trace),
        differences_of(trace),
        vibration=vibration(trace),
        clipped={what: n for what, why in CLIPPED.items() if (n := trace.rejected[why])},
        warnings=by_name(warned_s),
        refused=trace.refused,
        autopilot_vibration=_own_vibration(trace, window),
    )


def vibration(trace: VehicleTrace) -> Vibration | None:
    """The vibration of a replayed log; None where the IMU's stream is too slow to show it."""
    acc, step_s = trace["acc_m_s2"], trace.step_s
    if not 0.0 < step_s <= 1.0 / LEAST_RATE_HZ:
        return None
    square = _low_pass((acc - _low_pass(acc, MEAN_HZ, step_s)) ** 2, SQUARE_HZ, step_s)
    return Vibration(*_exceeded(np.sqrt(square)))


def _own_vibration(trace: VehicleTrace, window: TimeWindow) -> OwnVibration | None:
    """The autopilot's own figures, in the window alone if there is one."""
    readings = [*vibrations(trace.log, trace.address, trace.kind[0])]
    if window != WHOLE_LOG:
        begin_us, end_us = trace["arrival_us"][[0, -1]].tolist()
        readings = [each for each in readings if begin_us <= each.arrival_us <= end_us]
    if not readings:
        return None
    sizes, latest = defaultdict[int, list[Vec3]](list), dict[int, int]()
    clipped = Counter[int]()
    for each in readings:
        if each.m_s2 is not None and all(map(isfinite, each.m_s2)):
            sizes[each.imu].append(each.m_s2)
        for imu, count in each.clipped.items():  # a restart of the autopilot sets it back to zero
            before = latest.get(imu, count)
            clipped[imu] += count - before if count >= before else count
            latest[imu] = count
    exceeded = [(imu, *_exceeded(np.array(each))) for imu, each in sizes.items()]
    imu, m_s2, verdict = max(exceeded, key=lambda each: max(each[1]), default=(0, None, None))
    return OwnVibration(readings[0].message, imu, m_s2, verdict, dict(sorted(clipped.items())))


def _exceeded(m_s2: Floats) -> tuple[Vec3, Verdict]:
    """What vibration (N, 3) exceeds for 5 % of the time, and how high that is."""
    x, y, z = np.percentile(m_s2, PERCENT, axis=0).round(2).tolist()
    most = max(x, y, z)
    verdict: Verdict = "too high" if most > MOST_M_S2 else "high"
    return (x, y, z), verdict if most >= USUAL_M_S2 else "usual"


def _low_pass(values: Floats, cutoff_hz: float, step_s: float) -> Floats:
    """A low-pass of first order over values (N, 3); starts at the first."""
    from scipy.signal import lfilter

    share = step_s / (step_s + 1.0 / (2.0 * pi * cutoff_hz))
    start = (1.0 - share) * values[:1]
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, axis=0, zi=start)[0])


def line(checked: Checked) -> str:
    """One log's line: the autopilot's attitude, then the sensors."""
    return f"{printable(checked.log)}: {'; '.join([_agreement(checked), *_sensors(checked)])}"


def _sensors(checked: Checked) -> Iterator[str]:
    """Vibration beside ArduPilot's limits, clipping, and the warnings of the live service."""
    ours, own = checked.vibration, checked.autopilot_vibration
    found = [] if ours is None else [f"vibration {ours.verdict}, {max(ours.m_s2):.1f} m/s²"]
    if own is not None and own.m_s2 is not None:
        found.append(f"the autopilot's {own.message} {own.verdict}, {max(own.m_s2):.1f} m/s²")
    if found:
        most = f"usual: under {USUAL_M_S2:.0f}, a problem: over {MOST_M_S2:.0f}"
        yield f"{', '.join(found)} ({most})"
    for sensor, count in checked.clipped.items():
        yield f"{sensor} clipped {count} times"
    if own is not None and any(own.clipped.values()):
        counts = ", ".join(f"{n} by IMU {imu + 1}" for imu, n in own.clipped.items() if n)
        yield f"readings clipped as {own.message} counts: {counts} (usual: under {USUAL_CLIPS})"
    for word, seconds in checked.warnings.items():
        yield f"{Alarm(word).meaning} for {seconds:.0f} s"


def _agreement(checked: Checked) -> str:
    if checked.fault:
        return f"not checked: {printable(checked.fault.removeprefix(f'{checked.log}: '))}"
    if checked.differences:
        worst = max(checked.differences, key=lambda each: each.end_s - each.begin_s)
        more = len(checked.differences) - 1
        return f"differs, {difference_text(worst)}" + (f" (and {more} more)" if more else "")
    looks = sum(checked.agreement.values())
    if not looks:
        return "no attitude of an autopilot to compare with"
    share = checked.agreement.get("agrees", 0) / looks
    return f"no difference; known to agree for {share:.0%} of the time"
