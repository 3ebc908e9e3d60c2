"""What an estimator says when it is told again what one was told in flight."""

from collections.abc import Mapping, Sequence
from math import radians
from typing import Any, NamedTuple

import numpy as np

from estimator.arrays import Floats
from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, scale
from estimator.live.core import with_attitude
from estimator.live.rows import (
    BIAS,
    NO_REPORT_ROWS,
    OUTPUT_SIZE,
    SIGMA,
    Q,
    Rows,
    cut,
    report_rows_of,
    reports_between,
)
from estimator.row_taking import put, take
from estimator.types import Quaternion, RateSample, VelocitySample
from tuning.logged_calls import Call

# A wrong start: 170 deg about NED (1,1,1)/sqrt 3, next to the unstable equilibrium, as the paper
# begins (e = 0.992).
WRONG_TURN = exp(scale(radians(170.0), (3**-0.5, 3**-0.5, 3**-0.5)))
NOTHING_WRONG: Mapping[int, Quaternion] = {}


class Course(NamedTuple):
    """What an estimator said at its N samples.

    ``q_ned_frd`` (N, 4); ``sigma_rad`` (N, 2) of inclination and heading; ``bias_rad_s`` (N, 3).
    """

    q_ned_frd: Floats
    sigma_rad: Floats
    bias_rad_s: Floats


def course_of(
    estimator: Estimator,
    rows: Rows,
    calls: Mapping[int, Sequence[Call]],
    wrong_ned_frd: Mapping[int, Quaternion] = NOTHING_WRONG,
    told: Floats = NO_REPORT_ROWS,
) -> Course:
    """Have the estimator take all rows, before each of them what it was told then.

    ``told`` (M, REPORT_SIZE) are velocities and rates, ``calls`` what else. Behind each sample in
    ``wrong_ned_frd`` the filter is given that attitude; what conditions its vectors goes on.
    """
    n, begin = len(rows.times_us), 0
    said = np.empty((n, OUTPUT_SIZE))
    for end in sorted({k for k in (*calls, *(k + 1 for k in wrong_ned_frd), n) if 0 < k <= n}):
        for call in calls.get(begin, ()):
            call(estimator)
        part = cut(rows, begin, end)
        take(estimator, part, said[begin:end], reports_between(told, begin, end))
        if end - 1 in wrong_ned_frd:
            now = estimator.snapshot
            core = with_attitude(now.core, wrong_ned_frd[end - 1])
            estimator.snapshot = now._replace(core=core)
            put(estimator, int(part.times_us[-1]), said[end - 1])
        begin = end
    return Course(said[:, Q], said[:, SIGMA], said[:, BIAS])


def split_calls(calls: Mapping[int, Sequence[Call]]) -> tuple[Floats, dict[int, Sequence[Call]]]:
    """Velocities and rates behind all other calls of a sample (M, REPORT_SIZE), and those."""
    told, others = [], {}
    for k, each in calls.items():
        reports = [_report(call) for call in each]
        first = max((at + 1 for at, report in enumerate(reports) if report is None), default=0)
        told += [(k, report) for report in reports[first:] if report is not None]
        if first:
            others[k] = each[:first]
    return report_rows_of(told), others


def _report(call: Call) -> VelocitySample | RateSample | None:
    """What a call shows, if that is a velocity or rates."""
    words: Any = call.__reduce__()[1]  # of a methodcaller: its name and arguments
    is_report = words[0] == "update_report" and isinstance(words[1], VelocitySample | RateSample)
    return words[1] if is_report else None
