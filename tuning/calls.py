"""What an estimator was given, written down as calls, and what it publishes when given it again."""

from collections.abc import Mapping, Sequence
from math import radians
from typing import Any, NamedTuple

import numpy as np

from estimator.estimator import Estimator
from estimator.geometry.quaternion import exp, scale
from estimator.live.core import with_attitude
from estimator.live.rows import (
    BIAS,
    OUTPUT_SIZE,
    SIGMA,
    Q,
    Rows,
    cut,
    report_rows_of,
    reports_between,
)
from estimator.profile import Profile
from estimator.reasons import Reason
from estimator.types import Floats, ImuSample, Quaternion, RateSample, VelocitySample

# A wrong start: 170 deg about NED (1,1,1)/sqrt 3, next to the unstable equilibrium, as the paper
# begins (e = 0.992).
WRONG_TURN = exp(scale(radians(170.0), (3**-0.5, 3**-0.5, 3**-0.5)))
NOTHING_WRONG: Mapping[int, Quaternion] = {}


class Call(NamedTuple):
    """A method of an estimator, and what it was called with."""

    method: str
    values: tuple[Any, ...] = ()

    def __call__(self, estimator: Estimator) -> None:
        """Call it again."""
        getattr(estimator, self.method)(*self.values)


Calls = Mapping[int, Sequence[Call]]  # before the sample of that number


def _logged(method: str) -> Any:
    """A method of the estimator that is logged before it takes effect."""

    def call(logged: "LoggedEstimator", *values: Any) -> Any:
        logged.log(method, *values)
        return getattr(Estimator, method)(logged, *values)

    return call


class LoggedEstimator(Estimator):
    """Counts the samples it has taken; ``calls[k]`` came between the sample before k and k."""

    def __init__(self, profile: Profile, fixed_gain: float | None = None) -> None:
        super().__init__(profile, fixed_gain)
        self.begin_log()

    def begin_log(self) -> None:
        """Forget what has been logged."""
        self.taken = 0
        self.calls: dict[int, list[Call]] = {}

    def log(self, method: str, *values: Any) -> None:
        """Remember a call before the next sample."""
        self.calls.setdefault(self.taken, []).append(Call(method, values))

    def update(self, sample: ImuSample) -> Reason | None:
        """See :class:`Estimator`."""
        reason = super().update(sample)
        self.taken += reason is None
        return reason

    def set_position(self, *place: Any) -> bool:
        """See :class:`Estimator`; what is no news changes nothing, whatever the numbers."""
        is_news = super().set_position(*place)
        if is_news:
            self.log("set_position", *place)
        return is_news

    update_report = _logged("update_report")  # velocities and rates come this way, too
    restart = _logged("restart")
    set_field_calibrated = _logged("set_field_calibrated")
    set_imu_lag = _logged("set_imu_lag")
    set_vehicle_class = _logged("set_vehicle_class")
    turn = _logged("turn")
    change_imu = _logged("change_imu")


class Course(NamedTuple):
    """What an estimator published at its N samples; sigmas of inclination and heading."""

    q_ned_frd: Floats  # (N, 4)
    sigma_rad: Floats  # (N, 2)
    bias_rad_s: Floats  # (N, 3)


def course_of(
    estimator: Estimator,
    rows: Rows,
    calls: Calls,
    reports: Floats,
    wrong_ned_frd: Mapping[int, Quaternion] = NOTHING_WRONG,
) -> Course:
    """Have the estimator take all rows, and before each of them its calls.

    ``reports`` (M, REPORT_SIZE) are velocities and rates. Behind each sample in
    ``wrong_ned_frd`` the filter is given that attitude; what conditions its vectors goes on.
    """
    n, begin = len(rows.times_us), 0
    published = np.empty((n, OUTPUT_SIZE))
    for end in sorted({k for k in (*calls, *(k + 1 for k in wrong_ned_frd), n) if 0 < k <= n}):
        for call in calls.get(begin, ()):
            call(estimator)
        part = cut(rows, begin, end)
        estimator.take_all(part, published[begin:end], reports_between(reports, begin, end))
        if end - 1 in wrong_ned_frd:
            now = estimator.snapshot
            core = with_attitude(now.core, wrong_ned_frd[end - 1])
            estimator.snapshot = now._replace(core=core)
            estimator.put(int(part.times_us[-1]), published[end - 1])
        begin = end
    return Course(published[:, Q], published[:, SIGMA], published[:, BIAS])


def split_calls(calls: Calls) -> tuple[Floats, Calls]:
    """Velocities and rates behind all other calls of a sample (M, REPORT_SIZE), and those."""
    reports, others, kinds = [], {}, VelocitySample | RateSample
    for k, each in calls.items():
        are_rows = [c.method == "update_report" and isinstance(c.values[0], kinds) for c in each]
        first = max((at for at, is_row in enumerate(are_rows, 1) if not is_row), default=0)
        reports += [(k, call.values[0]) for call in each[first:]]
        if first:
            others[k] = each[:first]
    return report_rows_of(reports), others
