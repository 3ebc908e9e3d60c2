"""One log's differences between the autopilot's attitude and ours, without its trace."""

from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from drivers.logs.time_window import WHOLE_LOG, TimeWindow
from estimator.errors import InputError
from estimator.profile import load_profile
from fuzzbee.replays.log_report import differences_of, replay_log, verdicts


class Checked(NamedTuple):
    """What one log says: its differences, worst first in order; or why it cannot be read."""

    log: str
    agreement: dict[str, int]
    differences: list[dict[str, Any]]
    fault: str

    @property
    def rank(self) -> tuple[bool, float]:
        """The larger, the worse."""
        seconds = sum(each["end_s"] - each["begin_s"] for each in self.differences)
        return bool(self.differences), seconds


def check_log(path: Path, profile: str, window: TimeWindow = WHOLE_LOG) -> Checked:
    """Replay a log; what cannot be read is said in its own line."""
    try:
        trace = replay_log(path, load_profile(profile), window=window)
    except InputError as error:
        return Checked(str(path), {}, [], str(error))
    found = [msgspec.to_builtins(each) for each in differences_of(trace)]
    return Checked(str(path), verdicts(trace), found, "")
