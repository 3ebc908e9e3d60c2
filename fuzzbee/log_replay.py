"""A log replayed for a program: the figures of ``fuzzbee replay``, the attitudes as arrays."""

from dataclasses import dataclass
from os import PathLike

import numpy as np

from estimator.profile import Profile
from estimator.types import Floats
from fuzzbee.arguments import file, number, profile_of
from fuzzbee.attitudes import Attitudes, attitudes_of, euler_curves_deg
from fuzzbee.options import time_window
from fuzzbee.replays.report import LogReport
from fuzzbee.replays.score import report_log
from fuzzbee.replays.trace import How


@dataclass(frozen=True)
class LogReplay:
    """The estimates of a log beside its reference, N rows, one for each sample that was used.

    ``reference_q_ned_frd`` (N, 4) is the simulator's truth or the autopilot's estimate, by
    ``report.reference``; ``error_rad`` (N, 3) the difference to it: total, heading and
    inclination. Both are NaN where the log has none. Times count from the first sample.
    """

    attitudes: Attitudes
    reference_q_ned_frd: Floats
    error_rad: Floats
    report: LogReport

    @property
    def reference_euler_deg(self) -> Floats:
        """The reference as roll, pitch and yaw (N, 3) in degrees, yaw from 0 to 360."""
        return euler_curves_deg(self.reference_q_ned_frd)


def replay(
    log: str | PathLike[str],
    profile: Profile | str = "imu",
    *,
    reference: str | None = None,
    skip_s: float = 0.0,
    system_id: int | None = None,
    gain: float | None = None,
    smooth: bool = False,
    columns: str | PathLike[str] | None = None,
    begin: float | str | None = None,
    end: float | str | None = None,
) -> LogReplay:
    """Run the filter over a log as fast as it goes, and score it.

    Args:
        log: the file.
        profile: what ``load_profile`` gives, or the name or file it would be given.
        reference: "sim" or "autopilot"; without it the truth, if the log has one.
        skip_s: the first seconds, which are left out of the report's errors.
        system_id: the vehicle; without it the one with most IMU samples.
        gain: fixes K.
        smooth: the attitudes that the whole log shows.
        columns: the TOML file that describes the columns of a table.
        begin: where to begin in the log: seconds, "arm" or "disarm".
        end: where to end, likewise.

    Raises:
        InputError: an argument of another kind; the log cannot be read, holds no IMU data of that
            vehicle, or lacks that reference.
    """
    how = How(
        gain,
        system_id,
        smooth=smooth,
        columns=None if columns is None else file("columns", columns),
        window=time_window(begin, end, ("begin", "end")),
    )
    skip_s = number("skip_s", skip_s, 0.0, of=" of seconds")
    path, chosen = file("log", log), profile_of(profile)
    trace, report = report_log(path, chosen, how, reference=reference, skip_s=skip_s)
    return LogReplay(
        attitudes=attitudes_of(trace, trace.zero_us),
        reference_q_ned_frd=np.array(trace["reference_q_ned_frd"]),
        error_rad=np.array(trace["error_rad"]),
        report=report,
    )
