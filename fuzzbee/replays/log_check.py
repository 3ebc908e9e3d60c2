"""One log's differences between the autopilot's attitude and ours, without its trace."""

from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from estimator.errors import InputError
from estimator.profile import load_profile
from estimator.reasons import Reason
from fuzzbee.replays.log_report import differences_of, refused_text, replay_log, verdicts
from fuzzbee.replays.vibration import Vibration, vibration
from service.alarms import Alarm

CLIPPED = {
    "accelerometer": Reason.ACCELEROMETER_SATURATED,
    "gyroscope": Reason.GYROSCOPE_SATURATED,
}
DIFFERS = Alarm.AUTOPILOT_DIFFERS  # the differences show more


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
        trace = replay_log(path, load_profile(profile), window=window)
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
